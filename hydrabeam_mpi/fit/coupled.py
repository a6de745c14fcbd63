"""The beams given what the data say of all channels, where these hang together over frequency.

The one place where they are solved for: as one matrix on rank 0, where it is not too large, or by conjugate gradients
over the rank groups, each of which keeps the information of its own channels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.matrix_free import N_SCALING, solve_matrix_free
from hydrabeam_mpi.inference.coupled import ChannelTold, CoupledEquations, CoupledPosterior, Moments, choose_length
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import DiagonalPrior, Prior
from hydrabeam_mpi.mpi import ProcessGrid, by_channel, share_by_channel, together
from hydrabeam_mpi.setup.over_frequency import Coupling
from hydrabeam_mpi.setup.problem import Problem

MAX_DENSE = 10_000
"""Unknowns up to which the system is one matrix: 0.8 GB, of which there are two at a time, and minutes of one core."""
NEGLIGIBLE = 1e-4
"""Lengths of which the evidence is less than this part of all are left out of the mean over lengths."""
MOST_REFINED = 3
"""Lengths that are added about the likeliest of the first: ln evidence is nearly a parabola in ln of the length."""
LEAST_GAIN = 0.1
"""Nats that a further length has to promise; where lengths are far apart a parabola promises less than there is."""


@dataclass(frozen=True)
class CoupledChannel:
    """What is kept of a channel that hangs together with others, to draw from all together again.

    Attributes
    ----------
    told : dict
        What the data say of its coefficients alone: ``information``, (n, n), kappa A^H N^-1 A, and ``score``, (n,),
        kappa A^H N^-1 (d - A b_0), b_0 the prior's mean. Empty with effects, with which that is not all.
    draws : ndarray, (n_draws, n)
        Those of the same number belong together in all channels.
    summary : dict
        What is told of all channels together.
    """

    told: dict[str, Array]
    draws: Array
    summary: dict[str, Any]


@dataclass(frozen=True)
class CoupledSolution:
    """The beams of channels that hang together.

    Attributes
    ----------
    posteriors : list of Posterior
        Of each of the group's channels, whatever the others are; on the group's root.
    channels : list of CoupledChannel
        Of these, on the group's root.
    joint : CoupledPosterior, optional
        Of all channels, on rank 0, where there was one matrix of one length.
    """

    posteriors: list[Posterior]
    channels: list[CoupledChannel]
    joint: CoupledPosterior | None


def solve_coupled(
    grid: ProcessGrid, problem: Problem, normals: Sequence[NormalEquations], n_draws: int
) -> CoupledSolution:
    """Solve for the beams of all channels together.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the group's channels.
    normals : sequence of NormalEquations
        Of these, summed over the group.
    n_draws : int
        How many draws are made.

    Raises
    ------
    InputError
        On all ranks, if the way to solve that the job asks for does not suffice.
    """
    coupling = problem.coupling
    assert coupling is not None
    told: list[ChannelTold] = []
    alone = 0.0
    with together(grid.world), grid.roots_alone():
        if grid.is_group_root:
            told = list(map(told_of, normals, problem.priors))
            alone = sum(_evidence_alone(one) for one in told)
    alone = grid.world.allreduce(alone)
    joint = None
    if dense_unknowns(coupling, problem.basis.n_modes):
        moments, summary, joint = _solve_dense(grid, problem, told, _noise(grid, problem, told, n_draws), n_draws)
    else:
        noise = _noise(grid, problem, told, max(n_draws, N_SCALING))
        moments, summary = solve_matrix_free(grid, problem.job.seed, coupling.candidates[0], told, noise)
    posteriors: list[Posterior] = []
    with together(grid.world), grid.roots_alone():
        if grid.is_group_root:
            for one, prior in zip(moments, problem.priors, strict=True):
                width = prior.std()
                covariance = one.covariance * width * width[:, np.newaxis]
                posteriors.append(posterior_of(prior.mean + width * one.mean, covariance))
    settings = coupling.settings.model_dump(mode="json", exclude_none=True)
    summary = {"settings": settings, **summary, "log_evidence_independent": alone}
    kept = []
    for normal, prior, one in zip(normals, problem.priors, moments, strict=False):
        draws = prior.mean + prior.std() * one.draws[:n_draws]
        information, score = _of_coefficients(normal, prior)
        kept.append(CoupledChannel({"information": information, "score": score}, draws, summary))
    return CoupledSolution(posteriors, kept, joint)


def dense_unknowns(coupling: Coupling | None, n: int) -> int:
    """Return how many unknowns are solved for as one matrix, with ``n`` coefficients a channel; 0 if not so.

    Raises
    ------
    InputError
        If the job needs one matrix, and does not allow it.
    """
    if coupling is None:
        return 0
    size = n * max(modes.shape[1] for modes in coupling.candidates)
    if coupling.settings.solver == "dense" or (coupling.settings.solver == "auto" and size <= MAX_DENSE):
        return size
    if len(coupling.candidates) > 1:
        raise InputError(
            f"only one matrix tells the evidence of a length, and it would have {size} rows",
            field="[prior.frequency] length",
            remedy="give one length, or shorter lists of channels or modes, or solver = 'dense' where memory allows it",
        )
    return 0


def told_of(normal: NormalEquations, prior: Prior) -> ChannelTold:
    """Return what the data say of a channel, from the sums over its rows."""
    information, score = _of_coefficients(normal, prior)
    assert isinstance(prior, DiagonalPrior)
    level = normal.log_det_inv_noise - normal.n_data * np.log(np.pi) - normal.misfit(BEAM, prior.mean)
    return ChannelTold.of(information, score, prior.sigma, float(level))


def _of_coefficients(normal: NormalEquations, prior: Prior) -> tuple[Array, Array]:
    """Return information and score of the coefficients about the prior's mean, (n, n) and (n,)."""
    kappa, own = 1.0 if normal.blocks[BEAM].is_complex else 2.0, normal.own(BEAM)
    return kappa * own, kappa * (normal.projection[BEAM] - own @ prior.mean)


def _evidence_alone(told: ChannelTold) -> float:
    """Return ln p(d) of a channel that knows nothing of the others."""
    equations = CoupledEquations(np.ones((1, 1)), len(told.score), np.iscomplexobj(told.score))
    equations.add(0, told)
    return float(equations.solve().joint.log_evidence or 0.0)


def _noise(grid: ProcessGrid, problem: Problem, told: list[ChannelTold], n_draws: int) -> list[Array]:
    """Draw the channels' parts of the noise of constrained realisations, (n, n_draws). Collective: all ranks."""
    with together(grid.world):
        keys = [
            [("posterior draw", number, draw) for draw in range(n_draws)] for number in problem.channel_numbers.tolist()
        ]
        return [one.noise(key, problem.job.seed, grid.n_channels) for one, key in zip(told, keys, strict=False)]


def _solve_dense(
    grid: ProcessGrid, problem: Problem, told: list[ChannelTold], noise: list[Array], n_draws: int
) -> tuple[list[Moments], dict[str, Any], CoupledPosterior | None]:
    """Solve on rank 0, for all lengths that the evidence leaves. Collective: all ranks of the grid."""
    coupling, seed = problem.coupling, problem.job.seed
    assert coupling is not None
    evidences = np.zeros(1)

    def evidence_of(modes: FloatArray) -> float:
        return _evidence(grid, assemble(grid, problem, modes, told))

    if len(coupling.candidates) > 1:
        evidences = np.array(list(map(evidence_of, coupling.candidates)))
    if coupling.may_refine:
        coupling, evidences = refined(coupling, evidences, evidence_of)
    candidates = coupling.candidates
    marginalises = coupling.settings.evidence == "marginalise"
    weights = _weights(evidences, marginalises)
    chosen = choose_length(weights, seed, n_draws)
    parts = []
    for number in np.flatnonzero(weights):
        posterior = assemble(grid, problem, candidates[number], told, noise, n_draws)
        evidences[number] = _evidence(grid, posterior)
        mine = chosen == number
        moments = posterior.moments(seed, np.flatnonzero(mine).tolist()) if posterior else ()
        parts.append((float(weights[number]), mine, share_by_channel(grid, moments)))
        # With the covariance, before the next one is assembled: there is memory for two matrices.
        del moments
        joint = posterior if len(candidates) == 1 else None
        del posterior
    best = int(np.argmax(evidences))
    summary: dict[str, Any] = {
        "solver": "dense",
        "covariances": "exact",
        "n_modes": candidates[best].shape[1],
        "n_unknowns": candidates[best].shape[1] * problem.basis.n_modes,
        "log_evidence": float(_log_mean(evidences) if marginalises else evidences[best]),
    }
    if coupling.lengths:
        summary["length"] = coupling.lengths[best]
    if len(candidates) > 1:
        of_lengths = coupling.lengths, evidences.tolist(), weights.tolist()
        summary |= dict(zip(("lengths", "log_evidences", "weights"), map(list, of_lengths), strict=True))
    mixed = [_mixed([(weight, mine, those[f]) for weight, mine, those in parts]) for f in range(len(told))]
    return mixed, summary, joint


def refined(
    coupling: Coupling, evidences: FloatArray, evidence_of: Callable[[FloatArray], float]
) -> tuple[Coupling, FloatArray]:
    """Add lengths about the likeliest, by parabolas through it and its neighbours, until these promise next to nothing.

    Parameters
    ----------
    coupling : Coupling
    evidences : ndarray, (Nlengths,)
        ln evidence of each of its lengths.
    evidence_of : callable
        Returns it for other modes along frequency, (Nchan, M).
    """
    for _ in range(MOST_REFINED):
        best = int(np.argmax(evidences))
        if not 0 < best < len(evidences) - 1:
            break
        about = slice(best - 1, best + 2)
        length, promised = top_of_parabola(np.log(coupling.lengths[about]), evidences[about])
        if promised < LEAST_GAIN:
            break
        coupling, place = coupling.with_length(float(np.exp(length)))
        evidences = np.insert(evidences, place, evidence_of(coupling.candidates[place]))
    return coupling, evidences


def top_of_parabola(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return where the parabola through three points is highest, the middle one of which is, and how far above that."""
    (left, right), (fall_left, fall_right) = x[::2] - x[1], y[::2] - y[1]
    # y - y[1] = slope t + curvature t^2, through both neighbours.
    curvature = (fall_right / right - fall_left / left) / (right - left)
    slope = fall_left / left - curvature * left
    if not curvature < 0:
        return float(x[1]), 0.0
    return float(x[1] - 0.5 * slope / curvature), float(-0.25 * slope**2 / curvature)


def assemble(
    grid: ProcessGrid,
    problem: Problem,
    modes: FloatArray,
    told: list[ChannelTold],
    noise: list[Array] | None = None,
    n_draws: int = 0,
) -> CoupledPosterior | None:
    """Bring together on rank 0 what the groups know, channel by channel, and solve. Collective: all ranks."""
    basis, equations, solved = problem.basis, None, None
    with together(grid.world):
        if grid.is_world_root:
            equations = CoupledEquations(modes, basis.n_modes, basis.is_complex, n_draws)
    records = [(one, None if noise is None else noise[f]) for f, one in enumerate(told)]
    for channel, (one, drawn) in enumerate(by_channel(grid, records)):
        assert equations is not None
        equations.add(channel, one, drawn)
    with together(grid.world), grid.roots_alone():
        if equations is not None:
            solved = equations.solve()
    return solved


def _evidence(grid: ProcessGrid, solved: CoupledPosterior | None) -> float:
    """Return ln p(d) of all channels, on all ranks. Collective: all ranks of the grid."""
    return float(grid.world.bcast(solved.joint.log_evidence if solved else None))


def _weights(evidences: FloatArray, marginalises: bool) -> FloatArray:
    """Return which part each length has: that of its evidence, or all for the likeliest."""
    if not marginalises:
        return np.asarray(np.arange(len(evidences)) == np.argmax(evidences), dtype=float)
    weights = np.exp(evidences - evidences.max())
    weights[weights < NEGLIGIBLE * weights.sum()] = 0.0
    return np.asarray(weights / weights.sum())


def _log_mean(evidences: FloatArray) -> float:
    return float(evidences.max() + np.log(np.mean(np.exp(evidences - evidences.max()))))


def _mixed(parts: Sequence[tuple[float, Array, Moments]]) -> Moments:
    """Return a channel's moments of the mean over lengths: of each its part, which draws are of it, and its moments."""
    first = parts[0][2]
    mean = sum((weight * one.mean for weight, _, one in parts), np.zeros_like(first.mean))
    covariance = np.zeros_like(first.covariance)
    draws = np.zeros((len(parts[0][1]), len(mean)), mean.dtype)
    for weight, mine, one in parts:
        away = one.mean - mean
        covariance += weight * (one.covariance + np.outer(away, away.conj()))
        draws[mine] = one.draws
    return Moments(mean, covariance, draws)


def posterior_of(mean: Array, covariance: Array) -> Posterior:
    """Return that of a channel's coefficients, as it is in the posterior of all.

    Raises
    ------
    InputError
        If rounding errors have left no covariance.
    """
    try:
        return Posterior.of(mean, covariance)
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"the posterior of a channel could not be taken out of that of all ({error})",
            field="[prior.frequency]",
            remedy="ask for fewer modes along frequency, or a longer length",
        ) from error
