"""Which effects a loop looks for: what the job wants and the data can carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS, SEPARATE, laws_of


@dataclass(frozen=True)
class Choice:
    """Which effects are looked for.

    Attributes
    ----------
    effects : list of Effect
    changes : list of Reweighting
    skipped : list of (str, str)
        Kinds that these data cannot carry, or that the job does not want, with the reason.
    leakage : bool
        Whether leakage is looked for in the other polarisations.
    """

    effects: list[Effect]
    changes: list[Reweighting]
    skipped: list[tuple[str, str]]
    leakage: bool


def choose(job: Job, setup: ObservingSetup) -> Choice:
    """Decide which effects to look for."""
    wanted: Sequence[str] = job.loop.effects or (*EFFECTS, *REWEIGHTINGS, *SEPARATE)
    present = {entry.kind for entry in job.effects}
    choice = Choice([], [], [], leakage=False)
    for kind in wanted:
        if kind in job.loop.skip:
            choice.skipped.append((kind, "the job says so ([loop] skip)"))
        elif kind in EFFECTS:
            effects = [effect for effect in laws_of(kind) if effect.is_sought]
            choice.effects.extend(one.sought_in(setup) for one in effects if one.not_applicable(setup) is None)
            choice.skipped.extend((kind, why) for effect in effects[:1] if (why := effect.not_applicable(setup)))
        elif kind in SEPARATE:
            choice = replace(choice, leakage=True)
        elif kind in REWEIGHTINGS and kind not in present:
            choice.changes.append(REWEIGHTINGS[kind]())
    return choice
