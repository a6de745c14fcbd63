"""The tutorial and the lines of the README run, and say what they promise."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyuvdata import AiryBeam

import hydrabeam_mpi as hb

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tutorial() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "tutorial.py"))


def test_the_posterior_predicts_and_covers_the_beam(tutorial: dict[str, Any]) -> None:
    assert tutorial["heldout"] == pytest.approx(1, abs=0.1)
    assert np.median(tutorial["error"]) < 2 * np.median(tutorial["std"])
    assert tutorial["error"].max() < 0.02 * tutorial["model_error"].max()


def test_the_loop_finds_the_gain(tutorial: dict[str, Any]) -> None:
    found = tutorial["found"]
    assert found.verdict == "explained"
    assert [one["effect"] for one in found.rounds] == ["antenna_gains"]
    (gain,) = (one for one in found.rounds[0]["parameters"] if one["name"] == "antenna 7 ln amplitude")
    assert abs(gain["value"] - np.log(1.05)) < 4 * gain["std"]
    assert tutorial["amended_heldout"] == pytest.approx(1, abs=0.1)


def test_every_public_name_is_documented() -> None:
    assert [name for name in hb.__all__ if not getattr(hb, name).__doc__] == []


def test_the_lines_of_the_readme_run(tutorial: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"^## In Python\n.*?^(    import .*?)\n\n`hb", (ROOT / "README.md").read_text(), re.M | re.S)
    monkeypatch.chdir(tmp_path)
    simulate = {"array": {"hex": [2, 3]}, "n_times": 24, "nsamples": 1.0}
    model = {"sky": {"n_sources": 100}, "beam": {"source": "airy", "diameter": 14.0}}
    perturb = {"perturb": {"stretch": [1.02, 1.02], "sidelobe": 0.0}}
    hb.simulate({"data": {"simulate": simulate | perturb}, **model}).uvd.write_uvh5("DATA.uvh5")
    known = {"uvbeam": AiryBeam(diameter=14.0, x_orientation="east"), "skymodel": model["sky"]}
    lines = "\n".join(line.removeprefix("    ") for line in code.splitlines())
    names: dict[str, Any] = dict(known)
    exec(lines, names)
    assert names["again"].summary == names["result"].summary
    assert names["found"].verdict == "consistent"
