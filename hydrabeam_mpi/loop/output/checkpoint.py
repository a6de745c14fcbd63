"""What a loop needs to go on: everything that it has found, and the last fit by channel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Diagnostics, Fit, Fitted
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.io.disk import writing
from hydrabeam_mpi.io.kept_rounds import new_round, read_object, write_object
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.mpi import bcast_object, gather_by_channel, together
from hydrabeam_mpi.terminal.interrupt import unbroken


@dataclass(frozen=True)
class KeptChannel:
    """What the last fit knows of one channel; see `Fit` and `Diagnostics`."""

    posterior: Posterior
    covariance: FloatArray | None
    beam_response: Array | None
    log_joint: float
    effective_parameters: float
    n_data: float


@dataclass(frozen=True)
class Kept:
    """A round as it is kept.

    Attributes
    ----------
    history : History
        Its fits have neither posteriors nor what belongs to them, and the chi^2 of all channels.
    seconds : dict
        Spent so far, by phase.
    """

    history: History
    seconds: dict[str, float]


def keep_round(
    context: FitContext, history: History, folder: Path, texts: dict[str, str], seconds: dict[str, float]
) -> None:
    """Write down a round that has ended, or the fit before the first.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    history : History
    folder : Path
        That is filled; the round appears whole in it.
    texts : dict
        Files for people to read, by name; of rank 0.
    seconds : dict
        Spent so far, by phase.

    Raises
    ------
    InputError
        On all ranks, if the disk takes no more.
    """
    kept = Kept(_lightened(context, history), dict(seconds))
    channels = gather_by_channel(context.grid, _channels_of(history.last.fitted, context.grid.is_group_root))
    with together(context.grid.world):
        if context.grid.is_world_root:
            with unbroken(), writing(folder), new_round(folder, len(history.rounds)) as place:
                write_object(place / "course", kept)
                for number, channel in enumerate(channels):
                    write_object(place / _name(number), channel)
                for name, text in texts.items():
                    (place / name).write_text(text)


def restore_round(context: FitContext, place: Path) -> Kept:
    """Read the round that is kept in ``place``, which rank 0 sees.

    Collective: all ranks of the grid.

    Raises
    ------
    InputError
        On all ranks, if it is damaged.
    """
    world = context.grid.world
    kept = None
    with together(world):
        if context.grid.is_world_root:
            kept = read_object(place / "course")
    whole: Kept = bcast_object(world, kept)
    mine = []
    for number in range(context.setup.observation.Nfreqs):
        channel = None
        with together(world):
            if context.grid.is_world_root:
                channel = read_object(place / _name(number))
        channel = bcast_object(world, channel)
        if number in context.channels:
            mine.append(channel)
    return replace(whole, history=_complete(context, whole.history, mine))


def _name(channel: int) -> str:
    return f"channel_{channel:04d}"


def _lightened(context: FitContext, history: History) -> History:
    """Leave out what is large or one rank's, and give every fit the chi^2 of all channels."""
    before = first = _light_check(context, history.first)
    rounds = []
    for one in history.rounds:
        rounds.append(_light_round(context, one, before))
        before = rounds[-1].after
    tried = [(_light(candidate), reason) for candidate, reason in history.tried]
    control = history.control and _light_round(context, history.control, before)
    ranking = tuple(map(_light, history.ranking))

    def light(checked: Checked) -> Checked:
        # The last fit stays one and the same: whether its prior has been adapted is told by that.
        return before if checked is history.last else _light_check(context, checked)

    adapted = [replace(one, before=light(one.before), after=light(one.after)) for one in history.adapted]
    return History(first, before, rounds, tried, ranking, control, history.control_since, adapted=adapted)


def _light_round(context: FitContext, one: Round, before: Checked) -> Round:
    """Keep of a round what it has found. Collective: all ranks of the grid."""
    candidate, ranking = _light(one.candidate), tuple(map(_light, one.ranking))
    return replace(one, candidate=candidate, ranking=ranking, before=before, after=_light_check(context, one.after))


def _light(candidate: Candidate) -> Candidate:
    """Leave out the fit that has told the weights."""
    return replace(candidate, weights=candidate.weights and replace(candidate.weights, start=Fitted()))


def _light_check(context: FitContext, checked: Checked) -> Checked:
    """Keep of a fit what its effects are. Collective: all ranks of the grid."""
    fitted = checked.fitted
    mine = fitted.diagnostics.train_chi2.tolist() if context.grid.is_group_root else []
    train_chi2 = np.concatenate(context.grid.world.allgather(mine))
    return replace(
        checked,
        fitted=Fitted(fitted.values, Fit(std=fitted.fit.std), Diagnostics(train_chi2, ended=fitted.diagnostics.ended)),
    )


def _channels_of(fitted: Fitted, is_group_root: bool) -> list[KeptChannel]:
    """Return what a fit knows of the rank group's channels; nothing on other ranks than its root."""
    if not is_group_root:
        return []
    fit, diagnostics = fitted.fit, fitted.diagnostics
    return [
        KeptChannel(
            # Without what may be cached beside these.
            Posterior(posterior.mean, posterior.factor, posterior.log_evidence),
            fit.covariances[f] if fit.covariances else None,
            fit.beam_response[f] if fit.beam_response else None,
            float(diagnostics.log_joint[f]),
            float(diagnostics.effective_parameters[f]),
            float(diagnostics.n_data[f]),
        )
        for f, posterior in enumerate(fit.posteriors)
    ]


def _complete(context: FitContext, history: History, mine: list[KeptChannel]) -> History:
    """Give every fit the rank group's chi^2, and the last one all that is known of the group's channels."""

    def local(checked: Checked) -> Checked:
        train_chi2 = checked.fitted.diagnostics.train_chi2[context.channels]
        diagnostics = Diagnostics(train_chi2, ended=checked.fitted.diagnostics.ended)
        return replace(checked, fitted=replace(checked.fitted, diagnostics=diagnostics))

    first = before = local(history.first)
    rounds: list[Round] = []
    for one in history.rounds:
        rounds.append(replace(one, before=before, after=local(one.after)))
        before = rounds[-1].after
    fit = Fit(
        posteriors=tuple(one.posterior for one in mine),
        covariances=tuple(one.covariance for one in mine if one.covariance is not None),
        beam_response=tuple(one.beam_response for one in mine if one.beam_response is not None),
        std=before.fitted.fit.std,
    )
    diagnostics = Diagnostics(
        before.fitted.diagnostics.train_chi2,
        np.array([one.log_joint for one in mine]),
        np.array([one.effective_parameters for one in mine]),
        np.array([one.n_data for one in mine]),
        before.fitted.diagnostics.ended,
    )
    whole = replace(before, fitted=Fitted(before.fitted.values, fit, diagnostics))

    def found(checked: Checked) -> Checked:
        return whole if checked is history.last else local(checked)

    adapted = [replace(one, before=found(one.before), after=found(one.after)) for one in history.adapted]
    control = history.control and replace(history.control, before=before, after=local(history.control.after))
    if rounds:
        rounds[-1] = replace(rounds[-1], after=whole)
    else:
        first = whole
    return replace(history, first=first, last=whole, rounds=rounds, adapted=adapted, control=control)
