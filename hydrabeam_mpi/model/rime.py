"""The forward model V = 1/2 sum_s I_s B(s) exp(2 pi i nu b.s/c), streamed over times (HDBI II, eqs 2 and 9)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.engines.base import Engine, Precision
from hydrabeam_mpi.model.positions import SourcePositions

Beam = Callable[[FloatArray, FloatArray], Array]


@dataclass(frozen=True)
class ForwardModel:
    """Sky and array, ready to be seen through any beam.

    Attributes
    ----------
    positions : SourcePositions
        Where the sources are at each time.
    flux : ndarray, (Nfreqs, Nsrc)
        Jy.
    freqs : ndarray, (Nfreqs,)
        Hz.
    engine : Engine
        Holds the baseline vectors.
    precision : type
        Of `design_columns`: of fringes, columns and their products; visibilities are always in double precision.
    """

    positions: SourcePositions
    flux: FloatArray
    freqs: FloatArray
    engine: Engine
    precision: Precision = np.float64

    def design_columns(self, basis: LinearBasis, times: IntArray) -> Iterator[FloatArray]:
        """Yield, time by time, the design of the real columns, (Nfreqs, 2, Nvectors, n_columns), in `precision`."""
        for time in times.tolist():
            index, za, az = self.positions.above_horizon(time)
            # Functions of a basis are evaluated faster at sources of nearly the same zenith angle.
            order = np.argsort(za)
            flux = np.take(self.flux, index[order], axis=1)
            yield self.engine.design(basis, za[order], az[order], flux, self.freqs, self.precision)

    def visibilities(self, beams: Sequence[Beam], times: IntArray) -> ComplexArray:
        """Simulate the visibilities that given beams see.

        Parameters
        ----------
        beams : sequence of callable
            One a channel, ``beam(za, az) -> (Npoints,)``; real or complex.
        times : ndarray of int
            Indices of the times.

        Returns
        -------
        ndarray, (Nfreqs, len(times), Nvectors)
            Jy.
        """
        rows = np.empty((len(self.freqs), len(times), self.engine.n_vectors), dtype=complex)
        for t, time in enumerate(times.tolist()):
            index, za, az = self.positions.above_horizon(time)
            flux = np.take(self.flux, index, axis=1)
            for f, beam in enumerate(beams):
                one = slice(f, f + 1)
                design = self.engine.design(_BeamColumns(beam), za, az, flux[one], self.freqs[one])
                rows[f, t] = _as_visibility(design)
        return rows


@dataclass(frozen=True)
class _BeamColumns:
    """A given beam as two real columns, its real and its imaginary part."""

    beam: Beam
    n_columns: int = 2

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate real and imaginary part of the beam, (2, Npoints), into ``out`` where it is given."""
        values = np.asarray(self.beam(za, az))
        columns = np.empty((2, len(za))) if out is None else out
        columns[0], columns[1] = values.real, values.imag
        return columns


def _as_visibility(design: FloatArray) -> ComplexArray:
    """Add up the columns Re B and Im B of a `_BeamColumns` design: (Re + i Im fringe)(Re B + i Im B)."""
    real, imag = design[0]
    return (real[:, 0] - imag[:, 1]) + 1j * (imag[:, 0] + real[:, 1])
