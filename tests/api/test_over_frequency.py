"""Beams that hang together over frequency, from a job to a result folder and back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tomli_w
from pyuvdata import UVBeam

import hydrabeam_mpi as hb
from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.config.effects import Effect

FREQS = [130.0e6, 130.4e6, 131.0e6, 132.0e6, 132.5e6, 134.0e6]
N_DRAWS = 12
JOB: dict[str, Any] = {
    "seed": 2,
    "data": {
        "simulate": {
            "array": {"hex": [2, 3]},
            "n_times": 8,
            "freqs": FREQS,
            "nsamples": 0.003,
            "perturb": {"stretch": [1.02, 1.01], "sidelobe": 0.0},
        }
    },
    "sky": {"n_sources": 120},
    "beam": {"source": "airy", "diameter": 14.0},
    "basis": {"n_modes": 40, "k_max": 40, "m_max": 0},
    "output": {"draws": N_DRAWS},
}
PROCESS = {"kind": "gaussian-process", "kernel": "matern-5/2"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("jobs")


def setup_of(folder: Path, **frequency: Any) -> hb.Setup:
    """A beam that is wider than the model's at all frequencies, seen with few data in each channel."""
    prior = {"fraction": 0.1, "floor": 0.03, "frequency": frequency}
    (folder / "job.toml").write_text(tomli_w.dumps({**JOB, "prior": prior}))
    return hb.Setup.from_job(folder / "job.toml")


@pytest.fixture(scope="module")
def alone(folder: Path) -> Result:
    return hb.infer(setup_of(folder))


@pytest.fixture(scope="module")
def together(folder: Path) -> Result:
    return hb.infer(setup_of(folder, **PROCESS))


def error_of(result: Result) -> float:
    maps = result.beam.maps
    return float(np.sqrt(np.mean((maps["mean"] - maps["truth"]) ** 2)))


def test_a_smooth_truth_is_found_better(alone: Result, together: Result) -> None:
    assert error_of(together) < 0.6 * error_of(alone)
    density = [one.heldout["log_density"].sum() for one in (alone, together)]
    assert density[1] > density[0] + 10
    told = together.summary["over_frequency"]
    own = [record.log_evidence for record in alone.content.channels]
    assert told["log_evidence_independent"] == pytest.approx(sum(own), rel=1e-10)
    assert told["log_evidence"] > told["log_evidence_independent"] + 10
    assert told["length"] == told["lengths"][int(np.argmax(told["log_evidences"]))]


def test_channels_that_are_far_apart_are_independent(folder: Path, alone: Result) -> None:
    far = hb.infer(setup_of(folder, **PROCESS, length=1e3)).beam
    assert np.max(np.abs(far.mean - alone.beam.mean) / alone.beam.std) < 1e-8
    np.testing.assert_allclose(far.std, alone.beam.std, rtol=1e-9)


def test_draws_are_made_again_from_the_file(folder: Path, together: Result) -> None:
    together.write(folder / "result")
    again = hb.load(folder / "result").beam
    with h5py.File(folder / "result" / "posterior.h5") as file:
        written = np.array([file[f"channel_{f:04d}"]["draws"][:] for f in range(len(FREQS))])
        told = json.loads(file.attrs["over_frequency"])
    assert told == together.summary["over_frequency"]
    draws = again.draw(N_DRAWS, seed=JOB["seed"])
    assert np.max(np.abs(draws.swapaxes(0, 1) - written) / again.std[:, np.newaxis]) < 1e-9
    # Neighbours go together: 0.4 of 4 MHz apart.
    away = (again.draw(200) - again.mean) / again.std
    assert np.corrcoef(away[:, 0].ravel(), away[:, 1].ravel())[0, 1] > 0.5
    beams = [UVBeam.from_file(path) for path in (folder / "result").glob("beam*.beamfits")]
    assert sum(one.Nfreqs for one in beams) == len(FREQS)


def test_lengths_are_averaged_by_their_evidence(folder: Path) -> None:
    told = {**PROCESS, "length": [1e6, 3e6, 8e6]}
    result = hb.infer(setup_of(folder, **told, evidence="marginalise"))
    summary = result.summary["over_frequency"]
    evidences, weights = np.array(summary["log_evidences"]), np.array(summary["weights"])
    expected = np.exp(evidences - evidences.max())
    np.testing.assert_allclose(weights, expected / expected.sum(), atol=1e-4)
    each = [hb.infer(setup_of(folder, **{**PROCESS, "length": length})).beam for length in told["length"]]
    mean = np.einsum("k,kfi->fi", weights, [one.mean for one in each])
    assert np.max(np.abs(result.beam.mean - mean) / result.beam.std) < 1e-8
    spread = sum(w * (one.std**2 + (one.mean - mean) ** 2) for w, one in zip(weights, each, strict=True))
    np.testing.assert_allclose(result.beam.std**2, spread, rtol=1e-8)


def test_polynomials_and_conjugate_gradients(folder: Path) -> None:
    polynomials = {"kind": "modes", "n_modes": 2}
    dense, iterated = (
        hb.infer(setup_of(folder, **polynomials, solver=solver)) for solver in ("dense", "conjugate-gradients")
    )
    assert np.max(np.abs(iterated.beam.mean - dense.beam.mean) / dense.beam.std) < 1e-8
    # Standard deviations from 64 draws, each uncertain by 9%.
    assert np.std(np.log(iterated.beam.std / dense.beam.std)) < 0.12
    assert any("are estimates" in one for one in iterated.summary["warnings"])
    with pytest.raises(hb.InputError, match="no more draws"):
        iterated.beam.draw(1)
    # Two polynomials: the third difference of a coefficient over its width is zero.
    widths = np.array([record.arrays["prior_std"] for record in dense.content.channels])
    means = np.array([record.arrays["prior_mean"] for record in dense.content.channels])
    over = (dense.beam.mean - means) / widths
    left = (
        over
        - np.polynomial.polynomial.polyval(
            np.array(FREQS) / 1e8, np.polynomial.polynomial.polyfit(np.array(FREQS) / 1e8, over, 1)
        ).T
    )
    assert np.max(np.abs(left)) < 1e-6 * np.max(np.abs(over))


@pytest.mark.parametrize(
    ("frequency", "words"),
    [
        (PROCESS, "the evidence of several lengths"),
        ({"kind": "modes", "n_modes": 2, "solver": "conjugate-gradients"}, "by one matrix alone"),
    ],
)
def test_effects_need_one_matrix(folder: Path, frequency: dict[str, Any], words: str) -> None:
    setup = setup_of(folder, **frequency)
    effect = Effect(kind="noise_level", values=6 * ((1.0,),), std=6 * ((0.1,),))
    with pytest.raises(hb.InputError, match=words):
        hb.infer(setup.amended(setup.job.model_copy(update={"effects": (effect,)})))
    for command in (hb.close_loop, hb.sample):
        with pytest.raises(hb.InputError, match=words):
            command(setup)


def test_a_result_is_no_prior_of_beams_that_hang_together(folder: Path, alone: Result) -> None:
    alone.write(folder / "earlier")
    prior = {"file": str(folder / "earlier"), "frequency": PROCESS}
    (folder / "job.toml").write_text(tomli_w.dumps({**JOB, "prior": prior}))
    with pytest.raises(hb.InputError, match="widths of independent coefficients"):
        hb.Setup.from_job(folder / "job.toml")
