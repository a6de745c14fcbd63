"""The joint fit of beams and effects: Gauss-Newton steps until neither moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.accumulate import accumulate_designs
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.infer.normal import NormalEquations
from hydrabeam_mpi.infer.posterior import Posterior
from hydrabeam_mpi.infer.prior import Prior
from hydrabeam_mpi.inference import reduce_normals, reduced_chi2, solve_channels
from hydrabeam_mpi.loop.equations import JointSums, SceneSums, beam_change
from hydrabeam_mpi.loop.evidence import Likelihood
from hydrabeam_mpi.loop.state import State
from hydrabeam_mpi.loop.workspace import Share
from hydrabeam_mpi.mpi import ProcessGrid, together
from hydrabeam_mpi.problem import Problem
from hydrabeam_mpi.rows import Rows

MAX_STEPS = 15
STEP_SIGMAS = 0.03
"""Converged when no parameter moves by more than this part of its standard deviation."""

STEPS_BACK = 0.5
"""Relative loss of ln(likelihood x prior) with which a step counts as a step too far.

A smaller loss is none: E is that of the beam before, so that the first steps seem better than they are.
"""
HELD = 1e10
"""Precision, in units of the prior's, with which undecidable combinations are held at zero."""


@dataclass(frozen=True)
class Space:
    """Where the loop works: the ranks, the problem and this rank's rows.

    Attributes
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the rank group's channels.
    experiment : Experiment
        Of all channels.
    train, test : Share
    """

    grid: ProcessGrid
    problem: Problem
    experiment: Experiment
    train: Share
    test: Share

    @property
    def channels(self) -> list[int]:
        """The numbers of this rank group's channels."""
        return [int(number) for number in self.problem.channel_numbers]

    def over_channels(self, values: FloatArray) -> float:
        """Add up what each group has of its channels, (Nlocal,). Collective: all ranks of the grid."""
        mine = float(np.sum(values)) if self.grid.is_group_root else 0.0
        return float(sum(self.grid.world.allgather(mine)))


def refit(space: Space, state: State) -> State:
    """Fit beams and effects jointly, from the values that the state has.

    Collective: all ranks of the grid. Given the effects the beams are solved for exactly; given the beams, the effects
    take a Gauss-Newton step in which the beams follow (the Schur complement).

    Returns
    -------
    State
        A new one.
    """
    state = replace(state, active=[replace(one) for one in state.active])
    best, last, beams = -np.inf, [one.x for one in state.active], state.posteriors
    for _ in range(MAX_STEPS):
        before, previous = state.posteriors, [one.x for one in state.active]
        rows, added = _fit_beams(space, state)
        if not state.active and not state.reweighted:
            return state
        reached = _objective(space, state)
        if not reached > best - STEPS_BACK * abs(best) and np.isfinite(best):
            # Too far for a linear step: half of it, from where it was better.
            for one, start in zip(state.active, last, strict=True):
                one.x = 0.5 * (one.x + start)
            state.posteriors = beams
            continue
        best, last, beams = reached, previous, state.posteriors
        moved = _step(space, state, rows, added) if state.active else 0.0
        moved = max(moved, _beam_moved(space, before, state.posteriors))
        if moved < STEP_SIGMAS:
            break
    _fit_beams(space, state)
    return state


def _objective(space: Space, state: State) -> float:
    """Return ln(likelihood x prior) of beams and effects, over all channels."""
    penalty = sum(
        float(np.sum((one.x[:1] if one.effect.shared else one.x)[:, one.used] ** 2 / one.prior_var[one.used]))
        for one in state.active
    )
    return space.over_channels(state.log_joint) - 0.5 * penalty


def _fit_beams(space: Space, state: State) -> tuple[Rows, ComplexArray]:
    """Solve for the beams given the effects; return the calibrated rows and E."""
    grid, share = space.grid, space.train
    with together(grid.world):
        rows, added = share.calibrated(state) if state.posteriors else (share.rows, np.zeros_like(share.rows.data))
        show = grid.world.rank == 0 and not state.posteriors
        normals = accumulate_designs(rows, share.designs(state, show), space.problem.basis)
    normals = reduce_normals(grid, normals)
    state.posteriors = solve_channels(grid, space.problem, normals)
    fitted = list(zip(normals, state.posteriors, space.problem.priors, strict=True))
    state.train_chi2 = np.array([reduced_chi2(normal, posterior) for normal, posterior, _ in fitted])
    state.log_joint = np.array([_log_joint(*one) for one in fitted])
    if grid.is_group_root:
        state.effective_parameters = np.array([_effective(normal, posterior) for normal, posterior, _ in fitted])
    return rows, added


def _log_joint(normal: NormalEquations, posterior: Posterior, prior: Prior) -> float:
    """Return ln(likelihood x prior) at the mean, up to terms that neither effects nor beams change."""
    away = posterior.mean - prior.mean
    penalty = np.vdot(away, prior.precision_times(away)).real / (1 if posterior.is_complex else 2)
    return -reduced_chi2(normal, posterior) * max(normal.n_data, 1) - float(penalty)


def _effective(normal: NormalEquations, posterior: Posterior) -> float:
    """Return how many real parameters the data have decided, tr(P^-1 kappa F^H N^-1 F) for real coefficients."""
    return 2 * float(np.sum(posterior.covariance * normal.gram.T).real)


def _step(space: Space, state: State, rows: Rows, added: ComplexArray) -> float:
    """Move the effects; return by how many standard deviations at most."""
    likelihoods = []
    state.follows = []
    for channel in range(len(space.channels)):
        sums = active_sums(space, space.train, state, channel, rows, added)
        posterior = state.posteriors[channel]
        state.follows.append(beam_change(posterior, sums.active.cross))
        if space.grid.is_group_root:
            with_beam_free = sums.active.without_beam(posterior)
            likelihoods.append((space.channels[channel], with_beam_free))
    gathered = space.grid.world.gather(likelihoods)
    answer = None
    with together(space.grid.world):
        if gathered is not None:
            by_channel = dict(pair for part in gathered for pair in part)
            answer = solve_jointly(state, [by_channel[f] for f in sorted(by_channel)])
    x, std, covariances, moved = space.grid.world.bcast(answer)
    place(state, x, std)
    state.covariances = [covariances[f] for f in space.channels]
    return float(moved)


def active_sums(space: Space, share: Share, state: State, channel: int, rows: Rows, added: ComplexArray) -> JointSums:
    """Sum over a group's rows what the active effects need. Collective: all ranks of `grid.world`."""
    basis = space.problem.basis
    total = JointSums.zeros(len(state.prior_var), [], basis.n_modes, basis.is_complex)
    number = space.channels[channel]
    with together(space.grid.world):
        for _, scene, design in share.scenes(channel, state, added[channel], rows):
            scene.integrate_for([one.effect for one in state.active])
            sums = SceneSums(scene, design)
            parts = [sums.part(one.effect.columns(scene, one.x[number]), one.used) for one in state.active]
            total.add(sums, parts, None, None)
    total.reduce(space.grid.group)
    return total


def solve_jointly(
    state: State, likelihoods: list[Likelihood]
) -> tuple[FloatArray, FloatArray, list[FloatArray], float]:
    """Take the Newton step of all active parameters in use.

    Parameters that channels share are solved for together, the others channel by channel given those.

    Returns
    -------
    x, std : ndarray, (Nfreqs, q)
    covariances : list of ndarray, (q, q)
    moved : float
        Largest step in standard deviations.
    """
    prior_var, x = state.prior_var, current(state)
    width = np.sqrt(prior_var)
    sizes = [len(one.used) for one in state.active]
    shared = np.repeat([one.effect.shared for one in state.active], sizes)
    s, p = np.flatnonzero(shared), np.flatnonzero(~shared)
    prior = _prior_precision(state, width)
    top, gradient = prior[np.ix_(s, s)].copy(), -prior[np.ix_(s, s)] @ (x[0, s] / width[s])
    channels = []
    for likelihood, values in zip(likelihoods, x, strict=True):
        matrix = width[:, np.newaxis] * likelihood.information * width
        score = width * likelihood.score
        own = np.linalg.inv(matrix[np.ix_(p, p)] + prior[np.ix_(p, p)])
        across = matrix[np.ix_(s, p)] @ own
        own_score = score[p] - prior[np.ix_(p, p)] @ (values[p] / width[p])
        top += matrix[np.ix_(s, s)] - across @ matrix[np.ix_(p, s)]
        gradient += score[s] - across @ own_score
        channels.append((own, across, own_score))
    common = np.linalg.inv(top)
    common_step = common @ gradient
    new, std, covariances = x.copy(), np.zeros_like(x), []
    for f, (own, across, own_score) in enumerate(channels):
        step, covariance = np.zeros(len(width)), np.zeros((len(width), len(width)))
        step[s], step[p] = common_step, own @ own_score - across.T @ common_step
        covariance[np.ix_(s, s)] = common
        covariance[np.ix_(p, s)] = -across.T @ common
        covariance[np.ix_(s, p)] = covariance[np.ix_(p, s)].T
        covariance[np.ix_(p, p)] = own + across.T @ common @ across
        covariances.append(width[:, np.newaxis] * covariance * width)
        std[f] = np.sqrt(np.diag(covariances[-1]))
        new[f] += _limited(state, width * step)
    return new, std, covariances, float(np.max(np.abs(new - x) / std, initial=0.0))


def _prior_precision(state: State, width: FloatArray) -> FloatArray:
    """Return the precision of the prior in units of its widths, with what is undecidable held at zero."""
    precision = np.eye(len(width))
    start = 0
    for one in state.active:
        span = slice(start, start + len(one.used))
        for combination in one.undecidable[:, one.used] * width[span]:
            precision[span, span] += HELD * np.outer(combination, combination) / np.vdot(combination, combination)
        start = span.stop
    return precision


def _limited(state: State, step: FloatArray) -> FloatArray:
    """Keep steps of strongly nonlinear parameters, such as positions, within their natural size."""
    limits = np.concatenate([np.zeros(0), *(one.step_limit[one.used] for one in state.active)])
    return np.clip(step, -limits, limits)


def current(state: State) -> FloatArray:
    """Return the active parameters in use, side by side, (Nfreqs, q)."""
    return np.concatenate([one.x[:, one.used] for one in state.active], axis=1)


def place(state: State, x: FloatArray, std: FloatArray) -> None:
    """Put parameters back where `current` took them from."""
    start = 0
    for one in state.active:
        span = slice(start, start + len(one.used))
        one.x, one.std = one.x.copy(), np.zeros_like(one.x)
        one.x[:, one.used], one.std[:, one.used] = x[:, span], std[:, span]
        start = span.stop


def _beam_moved(space: Space, before: list[Posterior], after: list[Posterior]) -> float:
    """Return the largest move of a channel's beam, rms over coefficients in standard deviations."""
    moved = 0.0 if len(before) == len(after) else np.inf
    for old, new in zip(before, after, strict=False):
        change = new.factor.conj().T @ (new.mean - old.mean)
        moved = max(moved, float(np.sqrt(np.mean(np.abs(change) ** 2))))
    return float(np.max(space.grid.world.allgather(moved)))
