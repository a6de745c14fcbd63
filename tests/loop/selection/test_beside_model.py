"""Gains that are far from one are found beside the model beam, and none where a fitted beam leaves less."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.api.loop import close_loop
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.beside_model import told_by_model
from tests.loop.mock import FREQ, context_of, load, mock_job, write_job

TWO = (FREQ, FREQ + 8e6)
PHASES = np.random.default_rng(7).uniform(-3, 3, 7)
EFFECTS = [CatalogueFlux(), AntennaGains()]


def uncalibrated(n_antennas: int = 7) -> dict[str, Any]:
    """Phases of the first antennas as they come from an array that nobody has calibrated."""
    parameters = {f"antenna {number} phase": float(PHASES[number]) for number in range(n_antennas)}
    return {"kind": "antenna_gains", "parameters": parameters | {"antenna 3 ln amplitude": 0.2}}


def asked(context: FitContext) -> Candidate | None:
    return told_by_model(context, refit(context, Values()), EFFECTS)


def phases_of(context: FitContext, found: Candidate) -> np.ndarray:
    """Return the phases with which a fit begins, (Nfreqs, Nants)."""
    assert found.finding is not None
    return found.finding.effect.begun(context.setup, found.finding.evidence.x)[:, 1::2]


def turned(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return by how much phases differ, but for what they have in common, rad."""
    factors = np.exp(1j * (one - other))
    return np.angle(factors / np.mean(factors, axis=-1, keepdims=True))


@pytest.mark.parametrize("freqs", [(FREQ,), TWO], ids=["one channel", "two channels"])
def test_gains_far_from_one_are_those_of_calibration(freqs: tuple[float, ...], tmp_path: Path) -> None:
    context = context_of(mock_job(uncalibrated(), freqs=freqs), tmp_path)
    found = asked(context)
    assert found is not None
    assert found.name == ("antenna_gains", "constant")
    # The model beam is narrower than the true one by two per cent.
    assert np.abs(turned(phases_of(context, found), PHASES)).max() < 0.02
    assert found.log_bayes_factor > 1000
    assert np.all(found.finding.evidence.prior_var > 0)


@pytest.mark.parametrize("strength", [0.001, 0.003])
def test_where_a_fitted_beam_leaves_less_there_is_none(strength: float, tmp_path: Path) -> None:
    context = context_of(mock_job({"kind": "antenna_gains", "strength": strength}), tmp_path)
    assert asked(context) is None


def test_they_are_not_looked_for_where_they_are_in_the_model(tmp_path: Path) -> None:
    context = context_of(mock_job(uncalibrated()), tmp_path)
    before = refit(context, Values())
    candidate = told_by_model(context, before, EFFECTS)
    assert candidate is not None
    assert told_by_model(context, before, [CatalogueFlux(), AntennaGains("alike")]) is None


@pytest.mark.mpi
def test_any_number_of_ranks_finds_the_same(comm: MPI.Comm, common_tmp_path: Path) -> None:
    found = asked(context_of(mock_job(uncalibrated(), freqs=TWO), common_tmp_path, comm))
    assert found is not None
    expected = comm.bcast(found.finding.evidence.x)
    np.testing.assert_allclose(found.finding.evidence.x, expected, rtol=1e-9)
    assert found.log_bayes_factor == pytest.approx(comm.bcast(found.log_bayes_factor), rel=1e-12)


def test_a_loop_calibrates_what_nobody_has(tmp_path: Path) -> None:
    """In one round, from where no linear model about a fitted beam leads."""
    write_job(mock_job(uncalibrated(), n_times=24), tmp_path)
    found = close_loop(Setup.of(load(MPI.COMM_SELF, tmp_path / "job.toml"), MPI.COMM_SELF))
    (only,) = found.record["rounds"]
    assert only["effect"] == "antenna_gains"
    assert found.verdict == "explained"
    phases = {one["name"]: one for one in only["parameters"] if one["name"].endswith("phase")}
    values = np.array([phases[f"antenna {number} phase"]["value"] for number in range(7)])
    std = np.array([phases[f"antenna {number} phase"]["std"] for number in range(7)])
    assert np.abs(turned(values, PHASES) / std).max() < 4
