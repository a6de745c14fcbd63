"""Settings of effects come from job files: what an effect cannot be is refused before anything is made of it."""

from __future__ import annotations

from typing import Any

import pytest

from hydrabeam_mpi.effects.registry import EFFECTS, make_effect
from hydrabeam_mpi.errors import InputError


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("antenna_gains", {"x": 1}),
        ("diffuse", {"l_max": 10**12}),
        ("diffuse", {"l_max": -1}),
        ("diffuse", {"l_max": "many"}),
        ("mutual_coupling", {"n_shells": 0}),
        ("basis_truncation", {"n_before": 1.5}),
        ("basis_truncation", {"n_before": -1}),
        ("missing_sources", {"sources": [[1e300, 2.0]]}),
        ("missing_sources", {"sources": [[10.0, float("nan")]]}),
        ("missing_sources", {"sources": [[10.0]]}),
        ("catalogue_flux", {"sources": [[1.0, 2.0]], "trials": 0}),
        ("cable_reflections", {"reflections": [["a", 1.0]]}),
        ("cross_coupling", {"baselines": [[1]]}),
        ("cross_coupling", {"baselines": 3}),
        ("horizon", {"walls": [[1.0, 2.0]]}),
        ("horizon", {"walls": [[0.0, 1e300, 0.0, 5.0]]}),
        ("horizon", {"strips": [[0, [0.0, 1.0, 0.0, 1.0]]]}),
    ],
)
def test_what_no_effect_has_is_refused(kind: str, settings: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="settings: are not understood; "):
        make_effect(kind, settings)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("diffuse", {"l_max": 85}),
        ("mutual_coupling", {"n_shells": 3}),
        ("basis_truncation", {"n_before": 128}),
        ("missing_sources", {"sources": [[359.5, -30.0], [0, -90]], "trials": 400}),
        ("cable_reflections", {"reflections": [[3, 150.5]]}),
        ("cross_coupling", {"baselines": [[3, 33], [35, 26]]}),
        ("horizon", {"walls": [[350.0, 370.0, 0.0, 5.0]], "strips": [[0, [350.0, 370.0, 4.0, 6.0]]], "trials": 36}),
    ],
)
def test_what_it_describes_makes_it_again(kind: str, settings: dict[str, Any]) -> None:
    effect = make_effect(kind, settings)
    assert effect.describe() == {**make_effect(kind, {}).describe(), **settings}
    assert type(make_effect(kind, effect.describe())) is EFFECTS[kind]
