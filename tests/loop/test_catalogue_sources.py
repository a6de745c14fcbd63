"""What is wrong with single catalogue sources is named for what it is, with its parameters, and nothing else is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from tests.loop.mock import context_of, mock_job, truth_of, write_job
from tests.loop.test_loop_command import assert_reproduced

BRIGHT = [128.76963789466896, -33.88094300453313]
"""Of the mock sky, 6 degrees from the zenith."""
NAME = "source ra=128.770 dec=-33.881"
ROTATION = 23.0
"""rad/m^2."""
OF_SOURCES = ["catalogue_flux", "missing_sources", "spectral_index", "source_positions", "polarised_sources"]


def found_of(folder: Path, injected: dict[str, Any], freqs: tuple[float, ...], n_times: int = 24) -> dict[str, float]:
    """Return what a loop tells of the one effect that it finds, in standard deviations from what was put in."""
    told = injected["parameters"]
    job = mock_job(
        {**injected, "parameters": {name: value for name, (value, _) in told.items()}},
        freqs=freqs,
        n_times=n_times,
        sky={"n_sources": 300},
        loop={"effects": [*OF_SOURCES, "antenna_gains", "diffuse"]},
    )
    job["seed"] = 3
    job["data"]["simulate"]["array"] = {"hex": [3, 4]}
    assert main(["loop", str(write_job(job, folder)), "-o", str(folder / "out")]) == 0
    loop = json.loads((folder / "out" / "loop.json").read_text())
    assert loop["verdict"] == "explained"
    (one,) = loop["rounds"]
    assert one["effect"] == injected["kind"]
    assert loop["error_before"] > 100
    n_heldout = 45 * (n_times // 3) * len(freqs)
    assert loop["error_after"] == pytest.approx(1.0, abs=3 / n_heldout**0.5)
    found = {parameter["name"]: parameter for parameter in one["parameters"]}
    assert set(found) == {name for _, name in told.values()}
    zero_of = dict.fromkeys(found, 0.0) | {f"{NAME}: rotation measure": ROTATION}
    return {name: (found[name]["value"] - value - zero_of[name]) / found[name]["std"] for value, name in told.values()}


@pytest.mark.study
def test_a_polarised_source_with_its_rotation_measure(tmp_path: Path) -> None:
    """By channels 2 MHz apart others, 27 rad/m^2 away, look nearly the same where the angle hardly turns."""
    injected = {
        "kind": "polarised_sources",
        "settings": {"sources": [BRIGHT], "rotation_measures": [ROTATION]},
        "parameters": {f"{NAME}: Q/I": (0.06, f"{NAME}: Q/I"), f"{NAME}: U/I": (-0.03, f"{NAME}: U/I")},
    }
    injected["parameters"][f"{NAME}: change of rotation measure"] = (0.0, f"{NAME}: rotation measure")
    off = found_of(tmp_path, injected, tuple(140e6 + 2e6 * n for n in range(6)))
    assert max(map(abs, off.values())) < 4


@pytest.mark.study
def test_a_source_beside_its_place(tmp_path: Path) -> None:
    names = {"relative flux error": -0.02, "offset east": 5.0, "offset north": -8.0}
    told = {f"{NAME}: {name}": (value, f"{NAME}: {name}") for name, value in names.items()}
    injected = {"kind": "source_positions", "settings": {"sources": [BRIGHT]}, "parameters": told}
    off = found_of(tmp_path, injected, (131e6,))
    assert max(map(abs, off.values())) < 4


def test_a_source_that_is_another_at_each_integration(tmp_path: Path) -> None:
    """Its values at the fitted times are told; of the others nothing is known but how large they are."""
    job = mock_job(n_times=24, sky={"n_sources": 300}, loop={"effects": [*OF_SOURCES, "antenna_gains", "gain_jitter"]})
    job["seed"] = 3
    job["data"]["simulate"]["array"] = {"hex": [3, 4]}
    settings = {"law": "anew", "times": times_of(job, tmp_path / "plain"), "sources": [BRIGHT]}
    job["data"]["simulate"]["effects"] = [{"kind": "catalogue_flux", "settings": settings, "strength": 1.0}]
    assert main(["loop", str(write_job(job, tmp_path)), "-o", str(tmp_path / "out")]) == 0
    loop = json.loads((tmp_path / "out" / "loop.json").read_text())
    (one,) = loop["rounds"]
    assert (loop["verdict"], one["effect"], one["law"]) == ("explained", "catalogue_flux", "anew")
    assert "Catalogue sources that scintillate" in one["sentence"]
    assert f"{NAME}: relative flux error 0." in one["sentence"]
    assert " rms over 1" in one["sentence"]
    context_of(job, tmp_path / "truth")
    (drawn,) = truth_of(tmp_path / "truth")
    truth = dict(zip(drawn["names"], np.ravel(drawn["values"]), strict=True))
    off = [(one["value"] - truth[one["name"]]) / one["std"] for one in one["parameters"]]
    assert max(map(abs, off)) < 4
    assert main(["infer", str(tmp_path / "out" / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    assert_reproduced(tmp_path / "out", tmp_path / "again")


def times_of(job: dict[str, Any], folder: Path) -> list[float]:
    """Return the times, JD, that a simulation has."""
    observation = context_of(job, folder).setup.observation
    return list(observation.times.tolist())


def test_a_source_that_scintillates(tmp_path: Path) -> None:
    """By several swings in a night, of which no drift or curvature knows anything."""
    sizes = {9: 0.3, 11: -0.4}
    names = {n: f"{NAME}: relative flux error, wave of Legendre order {n}, peak to peak" for n in sizes}
    injected = {
        "kind": "catalogue_flux",
        "settings": {"law": "smooth", "orders": [*sizes], "sources": [BRIGHT]},
        "parameters": {name: (sizes[n], name) for n, name in names.items()},
    }
    off = found_of(tmp_path, injected, (131e6,), n_times=36)
    assert max(map(abs, off.values())) < 4
