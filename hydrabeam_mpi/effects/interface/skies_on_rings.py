"""Skies that do not turn, as a quadrature on rings around the zenith has them, and what baselines see of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.model.engines.base import Columns, Engine, amplitude
from hydrabeam_mpi.model.engines.fringes import enu

AT_ONCE_BYTES = 2**26
"""Of what is seen of several rings at once: more than that saves no more time."""


@dataclass(frozen=True)
class SkiesOnRings:
    """Skies of which each ring has the same few functions of azimuth: flux_k(za, az) = across_k(za) along_j(k)(az).

    Attributes
    ----------
    za : ndarray, (Nrings,)
    az : ndarray, (Naz,)
        Of all rings, radians.
    along : ndarray, (J, Naz)
        The functions of azimuth.
    function : ndarray of int, (K,)
        Which of these each sky has, j(k).
    across : ndarray, (K, Nrings)
        What it is multiplied with on each ring, Jy a point.
    """

    za: FloatArray
    az: FloatArray
    along: FloatArray
    function: IntArray
    across: FloatArray

    def design(self, engine: Engine, basis: Columns, freq: float) -> FloatArray:
        """Return the design of each sky, (K, 2, Nvectors, n_columns); see `Engine.design`.

        On each ring J products are summed over azimuth; the K skies are combinations of these over the rings.
        """
        n_rows, n_columns, n_functions = 2 * engine.n_vectors, basis.n_columns, len(self.along)
        out = np.zeros((len(self.across), n_rows * n_columns))
        at_once = max(1, AT_ONCE_BYTES // (8 * n_rows * max(n_functions * n_columns, len(self.az))))
        for lo in range(0, len(self.za), at_once):
            rings = slice(lo, lo + at_once)
            za, az = np.broadcast_arrays(self.za[rings, np.newaxis], self.az)
            columns = basis.columns(za.ravel(), az.ravel()).reshape(n_columns, *za.shape)
            fringes = np.empty((2, engine.n_vectors, za.size))
            engine.fringes.fill(fringes, enu(za.ravel(), az.ravel()), amplitude(np.ones(za.size)), freq)
            fringes = fringes.reshape(n_rows, *za.shape)
            seen = np.empty((n_functions, len(za), n_rows * n_columns))
            for ring in range(len(za)):
                # What is multiplied out first is what there is less of: functions of azimuth, or columns.
                if n_columns < n_functions:
                    terms = fringes[:, np.newaxis, ring] * columns[:, ring]
                    seen[:, ring] = self.along @ terms.reshape(-1, len(self.az)).T
                else:
                    terms = self.along[:, np.newaxis] * fringes[:, ring]
                    seen[:, ring] = (terms.reshape(-1, len(self.az)) @ columns[:, ring].T).reshape(n_functions, -1)
            for j, of_function in enumerate(seen):
                own = np.flatnonzero(self.function == j)
                out[own] += self.across[own, rings] @ of_function
        return out.reshape(-1, 2, engine.n_vectors, n_columns)
