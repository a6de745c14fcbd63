"""What a loop knows of the beams before it looks for anything, such as that those of several channels are off alike."""

from __future__ import annotations

from typing import cast

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import EFFECTS, make_effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.prior_widths import is_adaptable
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.inference.prior import DiagonalPrior
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.mpi import together
from hydrabeam_mpi.terminal.progress import say


def known_kinds(job: Job) -> list[str]:
    """Return the kinds of effects that are not looked for, where the job leaves them to the loop."""
    if job.prior.widths == "stated" or job.prior.frequency.couples:
        return []
    return [kind for kind in EFFECTS if not EFFECTS[kind].is_sought and kind not in job.loop.skip]


def known_effects(job: Job, setup: ObservingSetup) -> list[Effect]:
    """Return the effects of `known_kinds` that the data can carry."""
    known = [make_effect(kind, {}) for kind in known_kinds(job)]
    return [one for one in known if one.not_applicable(setup) is None]


def with_what_is_known(context: FitContext, values: Values) -> Values:
    """Add to a job's effects those that are not looked for, as they are known of any beam: see `CommonBeam`.

    A prior of independent channels takes a tilt of all their beams for as many coincidences, and an error of the sky or
    of the pointing that explains them at once for the more certain the more channels there are. What is claimed has to
    hold with beams that are off alike as well as with beams that are not, so that both parts are as free as the job
    states. Of large bases those parameters are free that have the widest priors.

    Nothing is added where the job states the beams' prior once and for all (``[prior] widths = "stated"``, a prior from
    a file, channels that hang together), or does not want it (``[loop] skip``). Collective: all ranks of the grid.
    """
    setup, present = context.setup, {one.kind for one in values.active}
    known = [one for one in known_effects(context.problem.job, setup) if one.kind not in present]
    if not known or not is_adaptable(context):
        return values
    mine = (
        [cast(DiagonalPrior, prior).sigma ** 2 for prior in context.problem.priors]
        if context.grid.is_group_root
        else []
    )
    of_beam = np.array([one for part in context.grid.world.allgather(mine) for one in part])
    for effect in known:
        with together(context.grid.world):
            prior_var = effect.variances_beforehand(setup, of_beam)
            prior_var[np.argsort(-prior_var, kind="stable")[RULES.most_known :]] = 0.0
            values = values.extended(Active.start(effect, setup, prior_var, np.zeros((1, len(prior_var)))))
        say(f"part of the model beforehand: {effect.title}", context.grid.is_world_root)
    return values


def may_be_off_alike(context: FitContext, values: Values) -> bool:
    """Whether the beams of all channels may be off alike without that being as many coincidences.

    With one channel there is nothing to be alike, and with several of an independent prior only what is known of them
    beforehand says so: see `with_what_is_known`.
    """
    return context.setup.observation.Nfreqs == 1 or any(not one.effect.is_sought for one in values.active)
