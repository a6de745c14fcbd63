"""The engine that is expected to take least, from measured costs."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.model.engines.base import Columns, Engine, Precision
from hydrabeam_mpi.model.engines.gemm import GemmEngine
from hydrabeam_mpi.model.engines.nufft import NufftEngine

PRODUCT = 7.3e-11
"""Seconds of a source, vector and column in a matrix product: four operations at 55 per nanosecond, measured."""
FRINGE = 4.5e-9
"""Seconds of the fringe of a source on a vector of a lattice, measured."""
SPREAD = 5.3e-8
"""Seconds in which a source and column are spread onto the grid of an FFT to 1e-12, measured."""
CELL = 2.0e-8
"""Seconds of an FFT for each cell of the lattice and column, measured."""


class AutoEngine(Engine):
    """Matrix products or FFTs, whichever the number of sources, vectors and columns makes the faster.

    FFTs win on lattices only, from some hundred vectors on; elsewhere they must resolve the whole array in wavelengths.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Baseline vectors in metres ENU.
    tol : float
        Distance in metres within which vectors count as lying on a lattice.
    """

    @cached_property
    def _gemm(self) -> GemmEngine:
        engine = GemmEngine(self.vectors, self.tol)
        engine.points, engine.smearing = self.points, self.smearing
        return engine

    @cached_property
    def _nufft(self) -> NufftEngine:
        return NufftEngine(self.vectors)

    def choose(self, n_sources: int, n_columns: int, precision: Precision = np.float64) -> Engine:
        """Return the engine for so many sources and columns."""
        products, transforms = self.expected(n_sources, n_columns)
        no_transforms = precision == np.float32 or self.smearing is not None
        return self._gemm if products < transforms or no_transforms else self._nufft

    def expected(self, n_sources: int, n_columns: int) -> tuple[float, float]:
        """Return the seconds that matrix products and FFTs are expected to take; the latter for ever off a lattice."""
        products = n_sources * self.n_vectors * (PRODUCT * n_columns + FRINGE)
        lattice = self._gemm.fringes.lattice
        if lattice is None:
            return products, np.inf
        n_cells = int(np.prod(2 * np.abs(lattice.index).max(axis=0) + 1))
        return products, n_columns * (SPREAD * n_sources + CELL * n_cells)

    def design(
        self,
        basis: Columns,
        za: FloatArray,
        az: FloatArray,
        flux: FloatArray,
        freqs: FloatArray,
        precision: Precision = np.float64,
    ) -> FloatArray:
        """Compute the design of one time, (Nfreqs, 2, Nvectors, n_columns); see `Engine.design`."""
        chosen = self.choose(len(za), basis.n_columns, precision)
        return chosen.design(basis, za, az, flux, freqs, precision)
