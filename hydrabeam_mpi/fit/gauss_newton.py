"""The joint fit of beams and effects: Gauss-Newton steps until neither moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.accumulate import accumulate_designs
from hydrabeam_mpi.fit.channels import reduced_chi2, solve_channels
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.joint_step import solve_jointly
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.row_sums import active_columns, active_names, beam_columns, effect_equations, row_set
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Active, State
from hydrabeam_mpi.infer.posterior import Posterior
from hydrabeam_mpi.infer.prior import Prior
from hydrabeam_mpi.mpi import ProcessGrid, bcast_object, gather_objects, together
from hydrabeam_mpi.setup.problem import Problem

MAX_STEPS = 15
MAX_HALVED = 5
"""Times that a step is halved before the fit ends where it was best."""
STEP_SIGMAS = 0.03
"""Converged when no parameter moves by more than this part of its standard deviation.

Standard deviations are those of the noise; where the model leaves a reduced chi^2 above one, all that can be known is
worse by its root, and so is what counts as a move.
"""
FLAT_NATS = 0.01
"""Rise of ln(likelihood x prior), over reduced chi^2 where that is above one, that is none.

Parameters that still move by then drift where the data do not tell.
"""
FLAT_STEPS = 2
"""Steps in a row without a rise after which the fit has ended."""
STEPS_BACK = 0.5
"""Relative loss of ln(likelihood x prior) with which a step counts as a step too far where weights are fitted too."""


@dataclass(frozen=True)
class FitContext:
    """Where the loop works: the ranks, the problem and this rank's rows.

    Attributes
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the rank group's channels.
    setup : ObservingSetup
        Of all channels.
    train, test : RankData
    """

    grid: ProcessGrid
    problem: Problem
    setup: ObservingSetup
    train: RankData
    test: RankData

    @property
    def channels(self) -> list[int]:
        """The numbers of this rank group's channels."""
        return [int(number) for number in self.problem.channel_numbers]

    def over_channels(self, values: FloatArray) -> float:
        """Add up what each group has of its channels, (Nlocal,). Collective: all ranks of the grid."""
        mine = float(np.sum(values)) if self.grid.is_group_root else 0.0
        return float(sum(self.grid.world.allgather(mine)))


def refit(context: FitContext, state: State) -> State:
    """Fit beams and effects jointly, from the values that the state has.

    Collective: all ranks of the grid. Given the effects the beams are solved for exactly; given the beams, the effects
    take a Gauss-Newton step in which the beams follow (the Schur complement). That step does not know how E changes
    with the beams, which may be a lot; so E is computed with the beams as they have followed, and the step is shortened
    until beams and effects together are likelier than before. Where no part of it is, the fit ends where it was best.

    Returns
    -------
    State
        A new one.
    """
    state = replace(state, active=[_at_start(one) for one in state.active])
    best: tuple[float, list[FloatArray], list[Posterior]] | None = None
    flat = halved = 0
    length = 1.0
    for _ in range(MAX_STEPS):
        here, seen = [one.x for one in state.active], state.posteriors
        rows, added, reached = _fit_beams(context, state)
        if not state.active and not state.reweighted:
            return state
        if not seen:
            continue  # there were no beams to see E by
        misfit = max(1.0, context.over_channels(state.train_chi2) / context.setup.observation.Nfreqs)
        rise = np.inf if best is None else reached - best[0]
        # As weights change so does what is compared, and only a great loss is one.
        least = -STEPS_BACK * abs(best[0]) if best is not None and state.reweighted else -FLAT_NATS * misfit
        if best is not None and rise < least:
            if halved == MAX_HALVED:
                break
            halved, length = halved + 1, 0.5 * length
            state.posteriors = seen
            _shorten(state, best[1], best[2], 0.5)
            continue
        flat = flat + 1 if rise < FLAT_NATS * misfit else 0
        best, halved = (reached, here, seen if _adds(state) else state.posteriors), 0
        beam_moved = _beam_moved(context, seen, state.posteriors)
        moved = _step(context, state, rows, added) if state.active else 0.0
        if max(moved, beam_moved) < STEP_SIGMAS * np.sqrt(misfit) or flat == FLAT_STEPS:
            best = None
            break
        # What was too long once is begun with again at twice the length at which it was not.
        length = min(1.0, 2 * length)
        _shorten(state, best[1], best[2], length)
    if best is not None:
        # Not converged: to where it was best, and not where the last attempt led.
        for one, x in zip(state.active, best[1], strict=True):
            one.x = x
        state.posteriors = best[2]
    _fit_beams(context, state, keep=best is not None and _adds(state))
    return state


def _adds(state: State) -> bool:
    """Whether E may depend on the beams."""
    return any(not one.effect.multiplies and not one.effect.changes_sky for one in state.active)


def _at_start(one: Active) -> Active:
    """Return a copy, from zero where E was never fitted: how large it may be depends on how the beams give way."""
    adds = not one.effect.multiplies and not one.effect.changes_sky
    return replace(one, x=np.zeros_like(one.x)) if adds and not one.std.any() else replace(one)


def _shorten(state: State, x: list[FloatArray], beams: list[Posterior], length: float) -> None:
    """Take only part of a step from ``x`` and ``beams``, of the effects and of the beams that see E."""
    if length == 1.0:
        return
    for one, start in zip(state.active, x, strict=True):
        one.x = start + length * (one.x - start)
    pairs = zip(beams, state.posteriors, strict=True)
    state.posteriors = [replace(two, mean=one.mean + length * (two.mean - one.mean)) for one, two in pairs]


def _objective(context: FitContext, state: State, of_beams: FloatArray) -> float:
    """Return ln(likelihood x prior) of beams and effects, over all channels."""
    penalty = sum(
        float(np.sum((one.x[:1] if one.effect.shared else one.x)[:, one.used] ** 2 / one.prior_var[one.used]))
        for one in state.active
    )
    return context.over_channels(of_beams) - 0.5 * penalty


def _fit_beams(context: FitContext, state: State, keep: bool = False) -> tuple[Rows, ComplexArray, float]:
    """Solve for the beams given the effects; return the calibrated rows, E, and what was reached before solving.

    The last is ln(likelihood x prior) of the effects with the beams that E is seen by, or the best ones if there is
    no E. With ``keep`` the beams that E is seen by stay: E may be another one with those solved for.
    """
    grid, share = context.grid, context.train
    with together(grid.world):
        rows, added = share.calibrated(state) if state.posteriors else (share.rows, np.zeros_like(share.rows.data))
        show = grid.world.rank == 0 and not state.posteriors
        normals = accumulate_designs(rows, share.designs(state, show), context.problem.basis)
    for normal in normals:
        normal.reduce(grid.group)
    seen, state.posteriors = state.posteriors, solve_channels(grid, context.problem, normals)
    if keep:
        pairs = zip(state.posteriors, seen, strict=True)
        state.posteriors = [replace(solved, mean=one.mean) for solved, one in pairs]
    fitted = list(zip(normals, state.posteriors, context.problem.priors, strict=True))
    state.train_chi2 = np.array([reduced_chi2(normal, posterior) for normal, posterior, _ in fitted])
    state.log_joint = np.array([_log_joint(*one) for one in fitted])
    if grid.is_group_root:
        state.effective_parameters = np.array([_effective(normal, posterior) for normal, posterior, _ in fitted])
    # E is that of the beams before, so that only those tell what beams and effects reach together.
    together_with = seen if seen and _adds(state) else state.posteriors
    reached = np.array([_log_joint(*one) for one in zip(normals, together_with, context.problem.priors, strict=True)])
    return rows, added, _objective(context, state, reached)


def _log_joint(normal: NormalEquations, posterior: Posterior, prior: Prior) -> float:
    """Return ln(likelihood x prior) at the mean, up to terms that neither effects nor beams change."""
    away = posterior.mean - prior.mean
    penalty = np.vdot(away, prior.precision_times(away)).real / (1 if posterior.is_complex else 2)
    return -reduced_chi2(normal, posterior) * max(normal.n_data, 1) - float(penalty)


def _effective(normal: NormalEquations, posterior: Posterior) -> float:
    """Return how many real parameters the data have decided, tr(P^-1 kappa F^H N^-1 F) for real coefficients."""
    return 2 * float(np.sum(posterior.covariance * normal.own(BEAM).T).real)


def _step(context: FitContext, state: State, rows: Rows, added: ComplexArray) -> float:
    """Move the effects; return by how many standard deviations at most."""
    likelihoods = []
    state.beam_response = []
    for channel in range(len(context.channels)):
        sums = active_sums(context, context.train, state, channel, rows, added)
        posterior = state.posteriors[channel]
        names = active_names(state)
        state.beam_response.append(sums.response(BEAM, names, posterior))
        if context.grid.is_group_root:
            likelihoods.append((context.channels[channel], sums.likelihood(names, BEAM, posterior)))
    gathered = gather_objects(context.grid.world, likelihoods)
    answer = None
    with together(context.grid.world):
        if gathered is not None:
            by_channel = dict(pair for part in gathered for pair in part)
            answer = solve_jointly(state, current(state), [by_channel[f] for f in sorted(by_channel)])
    x, std, covariances, moved = bcast_object(context.grid.world, answer)
    change = x - current(state)
    place(state, x, std)
    state.covariances = [covariances[f] for f in context.channels]
    # E of the next step is seen by the beams that belong to these parameters, not by those before.
    followed = zip(state.posteriors, state.beam_response, context.channels, strict=True)
    state.posteriors = [replace(one, mean=one.mean + beam_response @ change[f]) for one, beam_response, f in followed]
    return float(moved)


def active_sums(
    context: FitContext, share: RankData, state: State, channel: int, rows: Rows, added: ComplexArray
) -> NormalEquations:
    """Sum over a group's rows what the active effects need. Collective: all ranks of `grid.world`."""
    total = effect_equations(context.problem.basis, state)
    with together(context.grid.world):
        for _, block, design in share.row_blocks(channel, state, added[channel], rows):
            block.integrate_for([one.effect for one in state.active])
            rows_of_scene = row_set(block)
            beside = {BEAM: beam_columns(rows_of_scene, design)}
            total.add_rows(active_columns(rows_of_scene, block, state), beside)
    total.reduce(context.grid.group)
    return total


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


def _beam_moved(context: FitContext, before: list[Posterior], after: list[Posterior]) -> float:
    """Return the largest move of a channel's beam, rms over coefficients in standard deviations."""
    moved = 0.0 if len(before) == len(after) else np.inf
    for old, new in zip(before, after, strict=False):
        change = new.factor.conj().T @ (new.mean - old.mean)
        moved = max(moved, float(np.sqrt(np.mean(np.abs(change) ** 2))))
    return float(np.max(context.grid.world.allgather(moved)))
