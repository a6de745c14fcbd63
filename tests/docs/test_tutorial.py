"""The tutorial runs, and says what it promises."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hydrabeam_mpi as hb

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tutorial() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "tutorial.py"))


def test_the_posterior_predicts_and_covers_the_beam(tutorial: dict[str, Any]) -> None:
    assert tutorial["heldout"] == pytest.approx(1, abs=0.1)
    assert np.median(tutorial["error"]) < 2 * np.median(tutorial["std"])
    assert tutorial["rms"] < 0.1 * tutorial["model_rms"]


def test_the_loop_finds_the_gain(tutorial: dict[str, Any]) -> None:
    found = tutorial["found"]
    assert found.verdict == "explained"
    assert [one["effect"] for one in found.rounds] == ["antenna_gains"]
    (gain,) = (one for one in found.rounds[0]["parameters"] if one["name"] == "antenna 7 ln amplitude")
    assert abs(gain["value"] - np.log(1.05)) < 4 * gain["std"]
    assert tutorial["amended_heldout"] == pytest.approx(1, abs=0.1)


def test_the_gain_is_taken_out(tutorial: dict[str, Any]) -> None:
    assert tutorial["gain_of_7"] == pytest.approx(1.05, abs=2e-3)
    assert not tutorial["folder"].exists()


def test_every_public_name_is_documented() -> None:
    assert [name for name in hb.__all__ if not getattr(hb, name).__doc__] == []
