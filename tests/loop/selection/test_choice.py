"""Which effects a loop looks for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS
from hydrabeam_mpi.loop.selection.choice import choose
from tests.loop.mock import context_of, mock_job

SOUGHT = {kind for kind, effect in EFFECTS.items() if effect.is_sought}
EVERY = SOUGHT | {*REWEIGHTINGS}
NOISE = {"kind": "noise_level"}
ONE = ((0.1,),)
GAIN = {"kind": "antenna_gains", "names": ("a",), "index": (2,), "values": ONE, "std": ONE, "prior_std": ONE}
WANTED: dict[str, tuple[dict[str, Any], list[dict[str, Any]], set[str]]] = {
    "all that there are": ({}, [], EVERY),
    "only these": ({"effects": ["antenna_gains", "outliers"]}, [], {"antenna_gains", "outliers"}),
    "not these": ({"skip": ["antenna_gains", "outliers"]}, [], EVERY - {"antenna_gains", "outliers"}),
    "no change of the weights twice": ({}, [NOISE], EVERY - {"noise_level"}),
    "an effect again, as another element may have it too": (
        {},
        [GAIN],
        EVERY,
    ),
}


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> ObservingSetup:
    return context_of(mock_job(), tmp_path_factory.mktemp("choice")).setup


@pytest.mark.parametrize(("loop", "effects", "wanted"), WANTED.values(), ids=WANTED)
def test_what_is_looked_for(
    setup: ObservingSetup, loop: dict[str, Any], effects: list[dict[str, Any]], wanted: set[str]
) -> None:
    """What these data cannot carry is skipped with its reason, and so is what the job does not want."""
    given = {name: tuple(kinds) for name, kinds in loop.items()}
    job = Job.model_validate({"data": {"files": ("data.uvh5",)}, "loop": given, "effects": tuple(effects)})
    choice = choose(job, setup)
    chosen = {one.kind for one in (*choice.effects, *choice.changes)}
    reasons = dict(choice.skipped)
    assert all(reasons.values())
    assert chosen <= wanted
    assert wanted - chosen <= {kind for kind, reason in choice.skipped if "the job says so" not in reason}
    assert {kind for kind, reason in reasons.items() if "the job says so" in reason} == set(loop.get("skip", ()))


def test_what_the_data_cannot_carry(tmp_path: Path) -> None:
    setup = context_of(mock_job(n_times=3), tmp_path).setup
    choice = choose(Job.model_validate({"data": {"files": ("data.uvh5",)}}), setup)
    skipped = dict(choice.skipped)
    for kind in SOUGHT:
        assert skipped.get(kind) == EFFECTS[kind]().not_applicable(setup)
