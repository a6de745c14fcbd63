"""The system of channels that hang together, by conjugate gradients over rank groups, without a matrix of it all.

Each group keeps the information J_f of its own channels and applies it; what travels are vectors, of which every
group's root has all (as large as the coefficients of all beams). The system of `hydrabeam_mpi.inference.coupled` is

    P_mm' = delta_mm' + sum_f U_fm U_fm' J_f,

preconditioned by its diagonal blocks D_m = B_m B_m^H, of which each root has its share of the Cholesky factors. They
are all of P where the channels tell as much as each other. What is solved is B^-1 P B^-H z = B^-1 x, in which the
length of a residual is nearly that of the error in posterior standard deviations, so that it tells when to stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse.linalg import LinearOperator, cg

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.coupled import ChannelTold, Moments, noise_of_modes
from hydrabeam_mpi.inference.matrices import cholesky_lower
from hydrabeam_mpi.mpi import Comm, ProcessGrid, allreduce_sum, roots_of

SIGMAS = 1e-10
"""Where the iterations end: rms over unknowns of the residual, about that of the error in posterior std."""
MAX_STEPS = 2000
AT_ONCE = 16
"""Right-hand sides that are solved at a time: each step is one product of matrices and one round of messages for all.
All 65 of a run at once take 0.7 to 1.05 of the time on one and two ranks, and four times the memory, which with dozens
of modes along frequency is more than that of a channel's matrix. What is solved does not depend on it."""
N_SCALING = 64
"""Draws that tell how large variances are, at least: each by itself to a sixth, those of a channel together better."""


class RootsSystem:
    """The system as the roots of the rank groups have it.

    Collective: all roots, as are all methods.

    Parameters
    ----------
    comm : Comm
        Of the roots, in the order of their channels.
    modes : ndarray, (Nchan, M)
    told : sequence of ChannelTold
        Of this root's channels.
    """

    def __init__(self, comm: Comm, modes: FloatArray, told: Sequence[ChannelTold]) -> None:
        self._comm, self.modes, self._told = comm, modes, told
        counts = comm.allgather(len(told))
        first = sum(counts[: comm.rank])
        self.channels = range(first, first + len(told))
        self.shape, self.dtype = (modes.shape[1], len(told[0].score)), told[0].information.dtype
        n_modes = modes.shape[1]
        self._mine = range(comm.rank * n_modes // comm.size, (comm.rank + 1) * n_modes // comm.size)
        self._factors = self._factorise()

    def _factorise(self) -> dict[int, Array]:
        """Return the Cholesky factors of this root's diagonal blocks."""
        factors = {}
        for mode in range(self.shape[0]):
            block = np.zeros((self.shape[1], self.shape[1]), self.dtype)
            for channel, one in zip(self.channels, self._told, strict=True):
                block += self.modes[channel, mode] ** 2 * one.information
            allreduce_sum(self._comm, block)
            if mode in self._mine:
                block[np.diag_indices_from(block)] += 1.0
                factors[mode] = cholesky_lower(block)
        return factors

    def times(self, x: Array) -> Array:
        """Return P x, both (M, n, k)."""
        beams = np.tensordot(self.modes[self.channels], x, 1)
        return x + self.from_channels([one.information @ beam for one, beam in zip(self._told, beams, strict=True)])

    def from_channels(self, mine: Sequence[Array]) -> Array:
        """Return sum_f U_fm y_f of what each root has of its channels, (n, ...); (M, n, ...), the same on all."""
        total = np.asarray(np.tensordot(self.modes[self.channels], np.array(mine), (0, 0)))
        allreduce_sum(self._comm, total)
        return total

    def unwhiten(self, z: Array) -> Array:
        """Return B^-H z, both (M, n, k)."""
        return self._through_factors(z, "C")

    def whiten(self, x: Array) -> Array:
        """Return B^-1 x, both (M, n, k)."""
        return self._through_factors(x, "N")

    def _through_factors(self, x: Array, trans: str) -> Array:
        parts = [
            solve_triangular(factor, x[mode], lower=True, trans=trans, check_finite=False)
            for mode, factor in self._factors.items()
        ]
        own = np.array(parts, dtype=self.dtype).reshape(len(parts), *x.shape[1:])
        return np.concatenate(self._comm.allgather(own))

    def solve(self, x: Array) -> tuple[Array, int]:
        """Return P^-1 x, both (M, n, k), and how many steps it took; none if that was not enough.

        One root iterates, and the others do each product with it: if each went on until its own numbers told it to
        stop, another last digit, as processors of different kinds have it, would leave one waiting for ever.
        """
        found, source = None, self.whiten(x)
        if self._comm.rank == 0:
            found = self._iterate(source)
            self._comm.bcast(None)
        else:
            while (z := self._comm.bcast(None)) is not None:
                self._times_whitened(z)
        solved, steps = self._comm.bcast(found)
        return self.unwhiten(solved), steps

    def _iterate(self, source: Array) -> tuple[Array, int]:
        """Return z with B^-1 P B^-H z = ``source``, both (M, n, k), and the steps, on the first root.

        To the iterations the k systems are one whose blocks are alike: they take about as many steps as the slowest of
        them, and end where the residual of all together is as small as that of one has to be.
        """
        steps = 0

        def count(_: Array) -> None:
            nonlocal steps
            steps += 1

        def times(z: Array) -> Array:
            return self._times_whitened(self._comm.bcast(z.reshape(source.shape))).ravel()

        operator = LinearOperator((source.size, source.size), times, dtype=self.dtype)
        enough = SIGMAS * np.sqrt(np.prod(self.shape))
        solved, failed = cg(operator, source.ravel(), rtol=0, atol=enough, maxiter=MAX_STEPS, callback=count)
        return solved.reshape(source.shape), 0 if failed else max(steps, 1)

    def _times_whitened(self, z: Array) -> Array:
        """Return B^-1 P B^-H z, both (M, n, k)."""
        return self.whiten(self.times(self.unwhiten(z)))

    def covariances(self) -> list[Array]:
        """Return sum_m U_fm^2 D_m^-1 of this root's channels, (n, n): that of a where D is all of P."""
        found = [np.zeros((self.shape[1], self.shape[1]), self.dtype) for _ in self._told]
        for mode in range(self.shape[0]):
            inverse = np.zeros((self.shape[1], self.shape[1]), self.dtype)
            if mode in self._mine:
                half = solve_triangular(self._factors[mode], np.eye(self.shape[1]), lower=True, check_finite=False)
                inverse += half.conj().T @ half
            allreduce_sum(self._comm, inverse)
            for channel, one in zip(self.channels, found, strict=True):
                one += self.modes[channel, mode] ** 2 * inverse
        return found


def solve_matrix_free(
    grid: ProcessGrid, seed: int, modes: FloatArray, told: list[ChannelTold], noise: list[Array]
) -> tuple[list[Moments], dict[str, Any]]:
    """Solve for mean and draws of all channels together by conjugate gradients.

    Covariances are those of the preconditioner with the variances that draws have; see `scaled`. Collective: all
    ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    seed : int
    modes : ndarray, (Nchan, M)
    told : list of ChannelTold
        Of the group's channels, on its root; empty on other ranks.
    noise : list of ndarray, (n, n_draws)
        These channels' parts of that of the draws, `N_SCALING` or more.

    Raises
    ------
    InputError
        On all ranks, if the iterations do not come to an end.
    """
    comm = roots_of(grid)
    moments: list[Moments] = []
    steps: list[int] = []
    if comm is not None:
        moments, steps = _solve(comm, seed, modes, told, noise)
        comm.Free()
    steps = grid.world.bcast(steps)
    if 0 in steps:
        raise InputError(
            f"conjugate gradients have not come to an end after {MAX_STEPS} steps",
            field="[prior.frequency] solver",
            remedy="set solver = 'dense', or ask for fewer modes along frequency, or a longer length",
        )
    size = modes.shape[1]
    n = grid.world.bcast(len(told[0].score) if told else None)
    return moments, {
        "solver": "conjugate-gradients",
        "covariances": "of the preconditioner, with variances from draws",
        "n_modes": size,
        "n_unknowns": size * n,
        "steps": max(steps),
    }


def _solve(
    comm: Comm, seed: int, modes: FloatArray, told: list[ChannelTold], noise: list[Array]
) -> tuple[list[Moments], list[int]]:
    """Solve on the groups' roots; also return the steps of each solution, up to one where they were not enough: 0."""
    system = RootsSystem(comm, modes, told)
    n, n_draws = system.shape[1], noise[0].shape[1]
    is_complex = np.issubdtype(system.dtype, np.complexfloating)
    # That of the mean, and those of the draws.
    sides = system.from_channels([np.column_stack([one.score, own]) for one, own in zip(told, noise, strict=True)])
    sides[..., 1:] += noise_of_modes(modes, range(n_draws), seed, n, is_complex)
    steps, solved = [], []
    for some in np.array_split(sides, -(-sides.shape[2] // AT_ONCE), axis=2):
        found, taken = system.solve(some)
        solved.append(np.tensordot(modes[system.channels], found, 1))
        steps.append(taken)
        if taken == 0:
            return [], steps
    moved = np.moveaxis(np.concatenate(solved, axis=2), 2, 0)
    means, away = moved[0], moved[1:]
    moments = []
    for f, covariance in enumerate(system.covariances()):
        moments.append(Moments(means[f], scaled(covariance, away[:, f]), means[f] + away[:, f]))
    return moments, steps


def scaled(covariance: Array, away: Array) -> Array:
    """Return a covariance, (n, n), with variances as draws about the mean have them, (n_draws, n).

    The ratio of these to those of the covariance scatters by the number of draws, and by what the covariance gets
    wrong. By how much it scatters more than by the former tells how far each ratio is to be believed beyond their mean.
    """
    ratio = np.mean(np.abs(away) ** 2, axis=0) / np.diag(covariance).real
    level = float(np.mean(ratio))
    by_chance = level**2 * (1 if np.iscomplexobj(away) else 2) / len(away)
    scatter = float(np.var(ratio))
    believed = max(scatter - by_chance, 0.0) / scatter if scatter else 0.0
    root = np.sqrt(level + believed * (ratio - level))
    return np.asarray(covariance * root * root[:, np.newaxis])
