"""Design rows by non-uniform FFTs."""

from __future__ import annotations

import finufft
import numpy as np
from threadpoolctl import threadpool_info

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.model.engines.base import Columns, Engine, Precision, amplitude
from hydrabeam_mpi.model.engines.fringes import C_M_PER_S, enu


class NufftEngine(Engine):
    """Type-3 non-uniform FFTs (finufft), for many sources: the cost does not grow as sources x baselines.

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
        dims = 2 if self.coplanar else 3
        points = [np.ascontiguousarray(axis) for axis in enu(za, az)[:dims]]
        for f, freq in enumerate(freqs):
            targets = [np.ascontiguousarray(axis) for axis in (2 * np.pi * freq / C_M_PER_S * self.vectors.T)[:dims]]
            for lo in range(0, n_columns, self.batch):
                strengths = amplitude(flux[f]) * columns[lo : lo + self.batch]
                values = self._transform(points, strengths.astype(complex), targets)
                out[f, 0, :, lo : lo + self.batch] = values.real.T
                out[f, 1, :, lo : lo + self.batch] = values.imag.T
        return out

    def _transform(self, points: list[FloatArray], strengths: ComplexArray, targets: list[FloatArray]) -> ComplexArray:
        transform = finufft.nufft2d3 if self.coplanar else finufft.nufft3d3
        values = transform(*points, strengths, *targets, isign=1, eps=self.eps, nthreads=self.threads)
        return np.atleast_2d(values)
