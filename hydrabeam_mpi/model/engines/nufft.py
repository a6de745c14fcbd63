"""Design rows by non-uniform FFTs."""

from __future__ import annotations

import finufft
import numpy as np
from threadpoolctl import threadpool_info

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray
from hydrabeam_mpi.model.engines.base import Columns, Engine, Precision, amplitude
from hydrabeam_mpi.model.engines.fringes import enu


class NufftEngine(Engine):
    """Non-uniform FFTs (finufft), for many sources: the cost does not grow as sources x baselines.

    On a lattice they are of type 1, with an FFT as large as the array in steps of the lattice; elsewhere of type 3,
    with one as large as the array in wavelengths.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Baseline vectors in metres ENU.
    eps : float
        Relative precision asked of the transform.
    batch : int
        Columns transformed at once.
    """

    def __init__(self, vectors: FloatArray, eps: float = 1e-12, batch: int = 64) -> None:
        super().__init__(vectors)
        self.eps = eps
        self.batch = batch
        self.coplanar = bool(np.abs(self.vectors[:, 2]).max(initial=0.0) < 1e-9)
        # finufft would take all cores, whatever share of them OpenMP has been limited to; 0 leaves it to finufft.
        pools = threadpool_info()
        self.threads = max((pool["num_threads"] for pool in pools if pool["user_api"] == "openmp"), default=0)

    def design(
        self,
        basis: Columns,
        za: FloatArray,
        az: FloatArray,
        flux: FloatArray,
        freqs: FloatArray,
        precision: Precision = np.float64,
    ) -> FloatArray:
        """Compute the design of one time, (Nfreqs, 2, Nvectors, n_columns); see `Engine.design`.

        In double precision whatever is asked: in single one would lose the phases.
        """
        n_vectors, n_columns = self.n_vectors, basis.n_columns
        out = np.zeros((len(freqs), 2, n_vectors, n_columns))
        if not len(za):
            return out
        columns = basis.columns(za, az)
        directions = enu(za, az)
        transform = self._anywhere if self.fringes.lattice is None else self._on_lattice
        for f, freq in enumerate(freqs):
            weights, wavenumber = amplitude(flux[f]), 2 * np.pi * freq / C_M_PER_S
            for lo in range(0, n_columns, self.batch):
                part = weights * columns[lo : lo + self.batch]
                # Two real columns are one complex one: what they give at b and at -b tells them apart.
                pairs = np.zeros((-(-len(part) // 2), len(za)), dtype=complex)
                pairs.real, pairs.imag[: len(part) // 2] = part[::2], part[1::2]
                plus, minus = transform(directions, pairs, wavenumber)
                for first, values in ((0, plus + minus.conj()), (1, -1j * (plus - minus.conj()))):
                    target = out[f, :, :, lo + first : lo + len(part) : 2]
                    of_columns = 0.5 * values[: target.shape[2]].T
                    target[0], target[1] = of_columns.real, of_columns.imag
        return out

    def _on_lattice(self, directions: FloatArray, strengths: ComplexArray, wavenumber: float) -> list[ComplexArray]:
        """Return the sums, (Nstrengths, Nvectors), at the vectors and at their negatives, by one FFT of the lattice."""
        lattice = self.fringes.lattice
        assert lattice is not None
        most = np.abs(lattice.index).max(axis=0)
        phases = np.mod(wavenumber * (lattice.generators @ directions), 2 * np.pi)
        modes = finufft.nufft2d1(
            *phases, strengths, tuple((2 * most + 1).tolist()), isign=1, eps=self.eps, nthreads=self.threads
        )
        modes = np.asarray(modes).reshape(len(strengths), *(2 * most + 1))
        return [modes[:, i, j] for i, j in ((most + lattice.index).T, (most - lattice.index).T)]

    def _anywhere(self, directions: FloatArray, strengths: ComplexArray, wavenumber: float) -> list[ComplexArray]:
        """Return the sums, (Nstrengths, Nvectors), at the vectors and at their negatives."""
        dims = 2 if self.coplanar else 3
        both = wavenumber * np.concatenate([self.vectors, -self.vectors])
        targets = [np.ascontiguousarray(axis) for axis in both.T[:dims]]
        points = [np.ascontiguousarray(axis) for axis in directions[:dims]]
        transform = finufft.nufft2d3 if self.coplanar else finufft.nufft3d3
        values = transform(*points, strengths, *targets, isign=1, eps=self.eps, nthreads=self.threads)
        return np.split(np.atleast_2d(values), 2, axis=1)
