"""The rows that a rank owns: read, calibrated, weighted, and compressed by redundancy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Visibilities
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.redundancy import RedundantGroups
from hydrabeam_mpi.io import noise
from hydrabeam_mpi.io.gains import apply_gains
from hydrabeam_mpi.io.uvdata import Block, read_visibilities
from hydrabeam_mpi.setup.problem import Problem


@dataclass(frozen=True)
class Rows:
    """The rows of a tile in the orientation of their redundant groups.

    Attributes
    ----------
    tile : Tile
    data : ndarray of complex, (Nfreqs, Ntimes, Nbls)
        Conjugated where the baseline points the other way than its group.
    inv_noise_var : ndarray, (Nfreqs, Ntimes, Nbls)
    groups : ndarray of int, (Nlocal,)
        The groups that the tile holds.
    member : ndarray of int, (Nbls,)
        Position in ``groups`` of each baseline's group.
    n_unflagged : int
        Number of visibilities that are not flagged, whether or not their noise is known.
    divisor : ndarray, (Nfreqs, Ntimes, Nbls), optional
        |d_read / d|^2, where gains or effects that multiply have been divided out of the data that were read.
    """

    tile: Tile
    data: ComplexArray
    inv_noise_var: FloatArray
    groups: IntArray
    member: IntArray
    n_unflagged: int
    divisor: FloatArray | None = None

    @classmethod
    def of(
        cls,
        tile: Tile,
        visibilities: Visibilities,
        redundant: RedundantGroups,
        n_unflagged: int,
        divisor: FloatArray | None = None,
        pol: int = 0,
    ) -> Rows:
        """Take the visibilities of ``tile`` in one polarisation, by its number.

        ``divisor``, if any, is in the shape of the visibilities' data.
        """
        data = visibilities.data[..., pol]
        flipped = redundant.flipped[tile.bls]
        groups, member = np.unique(redundant.group[tile.bls], return_inverse=True)
        oriented = np.where(flipped, data.conj(), data)
        # Not as views, which would keep the other polarisations.
        weights = np.ascontiguousarray(visibilities.inv_noise_var[..., pol])
        of_pol = None if divisor is None else np.ascontiguousarray(divisor[..., pol])
        return cls(tile, oriented, weights, groups, member, n_unflagged, of_pol)

    def at_times(self, times: IntArray) -> Rows:
        """Return the rows of some times alone, by their numbers in the observation; ``n_unflagged`` stays as it is."""
        chosen = np.isin(self.tile.times, times)
        return replace(
            self,
            tile=replace(self.tile, times=self.tile.times[chosen]),
            data=self.data[:, chosen],
            inv_noise_var=self.inv_noise_var[:, chosen],
            divisor=None if self.divisor is None else self.divisor[:, chosen],
        )

    def compressed(self) -> tuple[ComplexArray, FloatArray]:
        """Return sum(w d) and sum(w) over each group, (Nfreqs, Ntimes, Nlocal): exact sufficient statistics."""
        n_freqs, n_times, n_bls = self.data.shape
        member = csr_array((np.ones(n_bls), (np.arange(n_bls), self.member)), shape=(n_bls, len(self.groups)))
        flat, shape = (n_freqs * n_times, n_bls), (n_freqs, n_times, len(self.groups))
        weighted = (self.inv_noise_var * self.data).reshape(flat) @ member
        weights = self.inv_noise_var.reshape(flat) @ member
        return weighted.reshape(shape), weights.reshape(shape)


def read_rows(problem: Problem, tile: Tile, autos: Block | None = None) -> Rows:
    """Read the visibilities of a tile, and only those, with their weights.

    The autocorrelations at the tile's times, which weights may be made of, are not read if they are given.

    Raises
    ------
    InputError
        If a file cannot be used, or visibilities, gains or noise are not as they should be.
    """
    return read_rows_of_each([problem], tile, autos)[0]


def read_rows_of_each(problems: Sequence[Problem], tile: Tile, autos: Block | None = None) -> list[Rows]:
    """Read the same rows for problems that differ in their polarisation alone, all at once; see `read_rows`."""
    problem, noise_variance = problems[0], None
    if problem.noise_variance is not None:
        of_each = [one.noise_variance for one in problems if one.noise_variance is not None]
        noise_variance = np.concatenate(of_each, axis=2)
    observation = replace(problem.observation, pols=tuple(pol for one in problems for pol in one.observation.pols))
    files, job = problem.files, problem.job
    data, flags, nsamples = read_visibilities(files, observation, tile)
    divisor = None
    if problem.gain_files:
        data, flags, divisor = apply_gains(data, flags, observation, tile, problem.gain_files)
    if job.noise.sigma is not None:
        weights = noise.constant_weights(job.noise.sigma, flags, nsamples)
    elif problem.noise_file is not None:
        weights = noise.file_weights(problem.noise_file, observation, tile, flags, nsamples)
    elif noise_variance is not None:
        weights = noise.variance_weights(noise_variance[:, tile.bls], flags, nsamples)
    else:
        gains = problem.gain_files
        weights = noise.radiometer_weights(files, observation, tile, flags, nsamples, gains, autos)
    scale = problem.flux_scale.reshape(-1, 1, 1, 1)
    if np.any(scale != 1):
        data, weights = data * scale, weights / scale**2
    visibilities, n_unflagged = Visibilities(data, weights), np.sum(~flags, axis=(0, 1, 2)).tolist()
    return [
        Rows.of(tile, visibilities, one.redundant, count, divisor, pol)
        for pol, (one, count) in enumerate(zip(problems, n_unflagged, strict=True))
    ]
