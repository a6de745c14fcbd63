"""A formula for the model beam, where the elements' beam is that of a simulated feed over a dish."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hydrabeam_mpi as hb

SKY: dict[str, Any] = {"sky": {"n_sources": 400}, "seed": 5}


def loop_of(effects: list[dict[str, Any]]) -> Any:
    """Close the loop on 19 antennas with HERA's Vivaldi feed, with an Airy disc of 12 m to begin with."""
    simulate = {"array": {"hex": [3, 5]}, "n_times": 40, "freqs": [131e6], "nsamples": 0.1, "effects": effects}
    mock = hb.simulate({"data": {"simulate": simulate}, "beam": {"source": "hera-vivaldi-131MHz"}, **SKY})
    model = {"source": "airy", "diameter": 12.0}
    basis = hb.FourierBessel(n_modes=500, k_max=40, m_max=16)
    return hb.close_loop(hb.Setup(mock.uvd, beam=model, basis=basis, holdout={"kind": "times", "every": 2}, **SKY))


@pytest.mark.study
def test_what_a_formula_lacks_is_no_effect() -> None:
    """The beam is a tenth off the formula, 60 times the noise; nothing else is claimed."""
    found = loop_of([])
    assert {one["effect"] for one in found.rounds} <= {"basis_truncation"}
    (heldout,) = found.result.summary["channels"]
    assert heldout["heldout_rms_jy_unperturbed_scaled"] > 10 * heldout["heldout_rms_jy_noise"]
    assert heldout["heldout_rms_jy"] < 1.3 * heldout["heldout_rms_jy_noise"]
    assert abs(heldout["heldout_chi2_predictive"] - 1) < 0.15


@pytest.mark.study
def test_an_effect_beside_it_is_found() -> None:
    injected = {"kind": "antenna_gains", "parameters": {"antenna 5 ln amplitude": 0.1, "antenna 5 phase": 0.1}}
    found = loop_of([injected])
    assert found.verdict == "explained"
    assert {one["effect"] for one in found.rounds} - {"basis_truncation"} == {"antenna_gains"}
    (gains,) = (one for one in found.rounds if one["effect"] == "antenna_gains")
    told = {one["name"]: one for one in gains["parameters"]}
    for name, true in injected["parameters"].items():
        assert np.abs(told[name]["value"] - true) < 4 * told[name]["std"]
