"""What every visibility engine can do: from sources and beam to what a set of baseline vectors sees of them.

All of it follows from one sum (HDBI II, eq. 2),

    V_u(f) = 1/2 sum_s I_s(f) B(s, f) exp(+2 pi i nu_f b_u.s / c_light),

whose factor 1/2 is stated here, in `amplitude`, and nowhere else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.model.engines.fringes import Fringes
from hydrabeam_mpi.model.engines.smearing import Smearing

Precision = type[np.float64] | type[np.float32]

SOURCES_AT_ONCE = 1024
"""Sources whose fringes are in cache together."""


def amplitude(flux: FloatArray) -> FloatArray:
    """Return |V| of single sources, the same on all vectors: half of what their flux and the beam multiply to.

    Unpolarised emission gives half of its Stokes I to either of two crossed feeds.

    Parameters
    ----------
    flux : ndarray
        Jy; I or I B.

    Returns
    -------
    ndarray, same shape
        Jy.
    """
    return 0.5 * flux


def chunks(n_sources: int, most: int) -> list[tuple[int, int]]:
    """Return where chunks of sources begin and end, at least one: of equal size, as a short one costs nearly as much.

    Parameters
    ----------
    n_sources : int
    most : int
        In a chunk.
    """
    edges = np.linspace(0, n_sources, max(-(-n_sources // most), 1) + 1).astype(int).tolist()
    return list(pairwise(edges))


class Columns(Protocol):
    """What an engine needs of a beam basis: its real columns."""

    @property
    def n_columns(self) -> int:
        """Number of real columns."""

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate all columns, (n_columns, Npoints)."""


class Engine(ABC):
    """One way to compute what a fixed set of baseline vectors sees; engines are exchangeable (HDBI II, section 2.3).

    A new engine derives from this class and supplies `design`. Where sources are not summed, `responses` and `adjoint`
    serve every engine.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Baseline vectors in metres ENU.
    tol : float
        Distance in metres within which vectors count as lying on a lattice.

    Attributes
    ----------
    points : ndarray, (Npoints, 3), optional
        Where antennas stand, of which vectors may be differences; see `Fringes`.
    smearing : Smearing, optional
        Over what all that the vectors see are means.
    """

    points: FloatArray | None = None
    smearing: Smearing | None = None

    def __init__(self, vectors: FloatArray, tol: float = 1e-7) -> None:
        self.vectors = np.ascontiguousarray(vectors, dtype=float)
        self.tol = tol
        self._space = np.empty(0)

    @property
    def n_vectors(self) -> int:
        """Number of baseline vectors."""
        return len(self.vectors)

    @cached_property
    def fringes(self) -> Fringes:
        """The vectors' fringes, source by source."""
        return Fringes(self.vectors, self.tol, self.points, self.smearing)

    def _work_space(self, size: int) -> FloatArray:
        """Return the same one for all chunks and times: fresh pages cost as much as what is computed in them."""
        if self._space.size < size:
            self._space = np.empty(size)
        return self._space

    @abstractmethod
    def design(
        self,
        basis: Columns,
        za: FloatArray,
        az: FloatArray,
        flux: FloatArray,
        freqs: FloatArray,
        precision: Precision = np.float64,
    ) -> FloatArray:
        """Compute the design of one time, the sum over sources with each real column c of the basis as the beam.

            F[f, u, c] = 1/2 sum_s I_s(f) g_c(s) exp(+2 pi i nu_f b_u.s / c_light)

        Parameters
        ----------
        basis : Columns
            The beam basis.
        za, az : ndarray, (Nsrc,)
            Sources above the horizon, radians.
        flux : ndarray, (Nfreqs, Nsrc)
            Jy.
        freqs : ndarray, (Nfreqs,)
            Hz.
        precision : type
            In which fringes, columns and their products are computed; their phases and the sums are in double.

        Returns
        -------
        ndarray of float64, (Nfreqs, 2, Nvectors, n_columns)
            Real parts, then imaginary parts.
        """

    def responses(self, directions: FloatArray, flux: FloatArray, freq: float) -> ComplexArray:
        """Return the visibilities of single sources, the terms of the sum; all of them are held.

        Parameters
        ----------
        directions : ndarray, (3, Nsrc)
            Unit vectors towards the sources, ENU.
        flux : ndarray, (Nsrc,)
            What flux and beam multiply to, Jy.
        freq : float
            Hz.

        Returns
        -------
        ndarray of complex, (Nvectors, Nsrc)
            1/2 I_s B(s) exp(+2 pi i nu b_u.s / c_light), Jy.
        """
        parts = np.empty((2, self.n_vectors, directions.shape[1]))
        self.fringes.fill(parts, directions, amplitude(flux), freq)
        seen = np.empty(parts.shape[1:], dtype=complex)
        seen.real, seen.imag = parts
        return seen

    def adjoint(self, visibilities: ComplexArray, directions: FloatArray, flux: FloatArray, freq: float) -> FloatArray:
        """Correlate visibilities with the `responses` of single sources, of which only a few are held at a time.

        Parameters
        ----------
        visibilities : ndarray of complex, (Nvectors,)
        directions, flux, freq
            As for `responses`.

        Returns
        -------
        ndarray, (Nsrc,)
            Re sum_u conj(responses[u, s]) V_u.
        """
        out = amplitude(flux)
        for lo in range(0, len(out), SOURCES_AT_ONCE):
            some = slice(lo, lo + SOURCES_AT_ONCE)
            out[some] *= self.fringes.correlate(visibilities, directions[:, some], freq)
        return out
