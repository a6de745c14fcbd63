"""Design rows by non-uniform FFTs."""

from __future__ import annotations

import finufft
import numpy as np
from threadpoolctl import threadpool_info

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray
from hydrabeam_mpi.model.engines.base import Columns, Engine, Precision, amplitude, chunks
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
    chunk : int
        Sources of which the columns are held at once on a lattice; more where there are fewer than two of them a cell
        of the FFT, which is made anew for each chunk. Elsewhere that is so large that all are held.
    """

    def __init__(self, vectors: FloatArray, eps: float = 1e-12, batch: int = 64, chunk: int = 1 << 14) -> None:
        super().__init__(vectors)
        self.eps = eps
        self.batch = batch
        self.chunk = chunk
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
        out = np.zeros((len(freqs), 2, self.n_vectors, basis.n_columns))
        if not (len(za) and self.n_vectors):
            return out
        most = max(self.chunk, 2 * int(np.prod(self._cells))) if self.fringes.lattice else len(za)
        for lo, hi in chunks(len(za), most):
            space = self._work_space(basis.n_columns * (hi - lo))[: basis.n_columns * (hi - lo)]
            columns = basis.columns(za[lo:hi], az[lo:hi], out=space.reshape(basis.n_columns, hi - lo))
            directions = enu(za[lo:hi], az[lo:hi])
            for f, freq in enumerate(freqs):
                self._add(out[f], columns, directions, amplitude(flux[f, lo:hi]), 2 * np.pi * freq / C_M_PER_S)
        return out

    def _add(
        self, out: FloatArray, columns: FloatArray, directions: FloatArray, weights: FloatArray, wavenumber: float
    ) -> None:
        """Add what sources with some ``weights``, (Nsrc,), are seen as, to ``out``, (2, Nvectors, n_columns)."""
        transform = self._anywhere if self.fringes.lattice is None else self._on_lattice
        for lo in range(0, len(columns), self.batch):
            part = weights * columns[lo : lo + self.batch]
            # Two real columns are one complex one: what they give at b and at -b tells them apart.
            pairs = np.zeros((-(-len(part) // 2), len(weights)), dtype=complex)
            pairs.real, pairs.imag[: len(part) // 2] = part[::2], part[1::2]
            plus, minus = transform(directions, pairs, wavenumber)
            for first, values in ((0, plus + minus.conj()), (1, -1j * (plus - minus.conj()))):
                target = out[:, :, lo + first : lo + len(part) : 2]
                of_columns = 0.5 * values[: target.shape[2]].T
                target[0] += of_columns.real
                target[1] += of_columns.imag

    @property
    def _cells(self) -> tuple[int, int]:
        """Points of the lattice along either generator that an FFT over all vectors and their negatives has."""
        lattice = self.fringes.lattice
        assert lattice is not None
        along, across = (2 * np.abs(lattice.index).max(axis=0) + 1).tolist()
        return along, across

    def _on_lattice(self, directions: FloatArray, strengths: ComplexArray, wavenumber: float) -> list[ComplexArray]:
        """Return the sums, (Nstrengths, Nvectors), at the vectors and at their negatives, by one FFT of the lattice."""
        lattice = self.fringes.lattice
        assert lattice is not None
        most = np.abs(lattice.index).max(axis=0)
        phases = np.mod(wavenumber * (lattice.generators @ directions), 2 * np.pi)
        modes = finufft.nufft2d1(*phases, strengths, self._cells, isign=1, eps=self.eps, nthreads=self.threads)
        modes = np.asarray(modes).reshape(len(strengths), *self._cells)
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
