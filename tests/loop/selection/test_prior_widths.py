"""The loop gives the beam's prior the widths that the data want: wider at first, any when it looks once more."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi import load_posterior
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection import prior_widths
from hydrabeam_mpi.loop.selection.prior_widths import describe
from tests.loop.mock import mock_job, write_job

GAIN = {
    "kind": "antenna_gains",
    "settings": {"law": "constant"},
    "parameters": {"antenna 3 ln amplitude": 0.04},
}


def loop_over(
    folder: Path,
    *injected: dict[str, Any],
    freqs: tuple[float, ...] = (150e6,),
    skip: tuple[str, ...] = (),
    **prior: Any,
) -> dict[str, Any]:
    settings = {"effects": ["antenna_gains", "missing_sources"], "skip": list(skip)}
    job = mock_job(*injected, freqs=freqs, n_times=24, prior=prior, loop=settings)
    assert main(["loop", str(write_job(job, folder)), "-o", str(folder / "out")]) == 0
    told: dict[str, Any] = json.loads((folder / "out" / "loop.json").read_text())
    return told


@pytest.fixture(scope="module")
def narrow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a loop whose beam is much further from its model than is stated."""
    folder = tmp_path_factory.mktemp("narrow")
    loop_over(folder, fraction=1e-4)
    return folder


def told_of(folder: Path) -> dict[str, Any]:
    told: dict[str, Any] = json.loads((folder / "out" / "loop.json").read_text())
    return told


def test_a_prior_that_is_too_narrow_gets_wider_and_nothing_is_claimed(narrow: Path, tmp_path: Path) -> None:
    loop, stated = told_of(narrow), loop_over(tmp_path, fraction=1e-4, widths="stated")
    assert stated["prior_widths"] == []
    assert stated["rounds"] or stated["verdict"] == "unexplained"
    assert loop["verdict"] == "consistent"
    assert loop["rounds"] == []
    first = loop["prior_widths"][0]
    assert first["wider"]
    assert first["fraction"] >= 1e-4
    assert first["log_bayes_factor"] > 100
    assert first["rms_after"] < min(first["rms_before"], 1.05 * first["rms_noise"])
    assert first["sentence"] in loop["said"]
    assert loop["error_after"] < stated["error_before"]


def test_the_amended_job_states_what_was_found(narrow: Path, tmp_path: Path) -> None:
    amended = tomllib.loads((narrow / "out" / "amended.toml").read_text())
    last = told_of(narrow)["prior_widths"][-1]
    assert amended["prior"]["fraction"] == last["fraction"]
    assert amended["prior"]["smooth"] == last["smooth"]
    assert amended["prior"]["widths"] == "stated"
    summary = json.loads((narrow / "out" / "summary.json").read_text())
    assert summary["prior_adapted"] == {
        name: last[name] for name in ("fraction", "neighbours", "azimuthal", "smooth", "shape")
    }
    assert last["shape"]
    assert main(["infer", str(narrow / "out" / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    one, two = (load_posterior(folder / "posterior.h5") for folder in (narrow / "out", tmp_path / "again"))
    assert np.max(np.abs(one.mean - two.mean) / one.std) < 1e-6


def test_infer_comes_to_the_same(narrow: Path, tmp_path: Path) -> None:
    """Where nothing is found the loop's last beam is the one that infer gives with widths = "evidence"."""
    job = tomllib.loads((narrow / "job.toml").read_text())
    job["prior"]["widths"] = "evidence"
    assert main(["infer", str(write_job(job, tmp_path)), "-o", str(tmp_path / "out")]) == 0
    one, two = (load_posterior(folder / "out" / "posterior.h5") for folder in (narrow, tmp_path))
    assert np.max(np.abs(one.mean - two.mean) / one.std) < 0.1


def test_an_effect_comes_before_wider_widths_where_it_explains_more(tmp_path: Path) -> None:
    loop = loop_over(tmp_path, GAIN, fraction=0.1)
    (found,) = loop["rounds"]
    assert found["effect"] == "antenna_gains"
    assert loop["verdict"] == "explained"
    (gain,) = [one for one in found["parameters"] if one["name"] == "antenna 3 ln amplitude"]
    assert gain["value"] == pytest.approx(0.04, abs=4 * gain["std"])


def test_a_prior_that_is_too_wide_gets_narrower_in_the_end(tmp_path: Path) -> None:
    loop = loop_over(tmp_path, fraction=1000.0)
    assert loop["verdict"] == "consistent"
    (last,) = loop["prior_widths"]
    assert not last["wider"]
    assert last["log_density_after"] > last["log_density_before"] - 1.0
    assert loop["error_after"] == last["predictive_chi2_after"]
    assert loop["error_claimed"] == loop["error_after"]
    assert last["n_beyond"] == 0


def test_widths_by_which_held_out_data_are_less_likely_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By more than the rules let them be: with the prior of the test above it is by a fifth of a nat."""
    monkeypatch.setattr(prior_widths, "RULES", replace(RULES, no_worse=0.0))
    loop = loop_over(tmp_path, fraction=1000.0)
    assert loop["verdict"] == "consistent"
    assert loop["prior_widths"] == []


def test_widths_that_explain_more_than_any_effect_come_first_even_if_narrower(tmp_path: Path) -> None:
    """A gain of 0.25% in data that tell a far too free prior from a good one better than that."""
    faint = {**GAIN, "parameters": {"antenna 3 ln amplitude": 0.0025}}
    loop = loop_over(tmp_path, faint, fraction=1000.0)
    first = loop["prior_widths"][0]
    assert not first["wider"]
    assert first["n_rounds"] == 0
    (found,) = loop["rounds"]
    assert found["effect"] == "antenna_gains"
    assert first["log_bayes_factor"] > found["log_bayes_factor"]
    (gain,) = [one for one in found["parameters"] if one["name"] == "antenna 3 ln amplitude"]
    assert gain["value"] == pytest.approx(0.0025, abs=4 * gain["std"])


@pytest.mark.parametrize("alike", [True, False])
def test_so_it_is_with_several_channels_whose_beams_may_be_off_alike(tmp_path: Path, alike: bool) -> None:
    """Where they may not, widths less than the stated ones are for prediction alone."""
    faint = {**GAIN, "parameters": {"antenna 3 ln amplitude": 0.0025}}
    skip = () if alike else ("common_beam",)
    loop = loop_over(tmp_path, faint, freqs=(150e6, 152e6, 154e6), skip=skip, fraction=1000.0)
    (found,) = [one for one in loop["rounds"] if not one["revoked"]]
    assert found["effect"] == "antenna_gains"
    (gain,) = [one for one in found["parameters"] if one["name"] == "antenna 3 ln amplitude"]
    assert gain["value"] == pytest.approx(0.0025, abs=4 * gain["std"])
    first = loop["prior_widths"][0]
    assert not first["wider"]
    assert first["n_rounds"] == (0 if alike else len(loop["rounds"]))
    assert (loop["error_claimed"] == loop["error_after"]) is alike


WIDE = {
    "basis": {"n_modes": 24, "k_max": 24, "m_max": 0, "boundary": "dirichlet"},
    "beam": {"source": "airy", "diameter": "4 m"},
    "loop": {"effects": ["antenna_gains", "missing_sources", "basis_truncation"]},
}
"""A beam that is not zero at the edge, where all functions of its basis are."""


def loop_of_wide(folder: Path, *injected: dict[str, Any], **prior: Any) -> dict[str, Any]:
    job = mock_job(*injected, n_times=24, prior=prior, **WIDE)
    assert main(["loop", str(write_job(job, folder)), "-o", str(folder / "out")]) == 0
    return told_of(folder)


def test_what_no_beam_in_the_basis_can_follow_is_no_finding(tmp_path: Path) -> None:
    loop = loop_of_wide(tmp_path)
    assert loop["verdict"] == "consistent"
    assert loop["rounds"] == []
    first = loop["prior_widths"][0]
    assert first["n_beyond"] == 1
    assert first["log_bayes_factor_beyond"] > 1000
    assert first["rms_after"] < 0.5 * first["rms_before"]
    assert "The beam got 1 function that none in its basis can follow" in first["sentence"]
    # The beam that is written has it.
    assert main(["infer", str(tmp_path / "out" / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    one, two = (load_posterior(folder / "posterior.h5") for folder in (tmp_path / "out", tmp_path / "again"))
    assert one.mean.shape[-1] == 25
    assert np.max(np.abs(one.mean - two.mean) / one.std) < 1e-6


def test_a_prior_that_stays_as_stated_leaves_it_to_be_found(tmp_path: Path) -> None:
    loop = loop_of_wide(tmp_path, widths="stated")
    assert [one["effect"] for one in loop["rounds"]] == ["basis_truncation"]


def test_a_gain_is_found_beside_what_the_basis_cannot_follow(tmp_path: Path) -> None:
    loop = loop_of_wide(tmp_path, GAIN)
    (found,) = loop["rounds"]
    assert found["effect"] == "antenna_gains"
    assert sum(one["n_beyond"] for one in loop["prior_widths"]) == 1
    (gain,) = [one for one in found["parameters"] if one["name"] == "antenna 3 ln amplitude"]
    assert gain["value"] == pytest.approx(0.04, abs=4 * gain["std"])


def test_widths_are_told_in_words() -> None:
    assert describe(None) == "those that are stated"
    assert describe(PriorWidths(0.25)) == "25% of the model's coefficients"
    assert describe(PriorWidths(0.0125, 1e-3, (0.1, 0.5))) == (
        "1.25% of the model's coefficients, beside 0.1% of the largest at low orders"
    )
    assert describe(PriorWidths(0.25, neighbours=True, azimuthal=(0.5, 3.0, 1.0))) == (
        "25% of the model's coefficients, times 0.5 to 3 by azimuthal order"
    )
