"""Which channels have no data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.io.calwrite import write_gains
from hydrabeam_mpi.setup.cautions import cautions_of_data, cautions_of_flags
from tests.loop.mock import context_of, mock_job

GOOD = {"freq_hz": 131e6, "n_data": 42, "heldout_n": 40.0}
EMPTY = {"freq_hz": 131.1e6, "n_data": 0}


def test_channels_without_data_are_named() -> None:
    assert cautions_of_flags([GOOD, GOOD], holds_out=True) == ()
    fitted, held_out = cautions_of_flags([GOOD, EMPTY, EMPTY | {"freq_hz": 132e6}], holds_out=True)
    assert fitted.startswith("At 131.1, 132 MHz all data to fit are flagged")
    assert held_out.startswith("At 131.1, 132 MHz all held-out data are flagged")


def test_where_nothing_was_to_be_held_out_nothing_lacks() -> None:
    assert cautions_of_flags([{"freq_hz": 131e6, "n_data": 42}], holds_out=False) == ()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, True),
        ({"prior": {"floor": 1e-3}}, False),
        ({"prior": {"widths": "evidence"}}, False),
        ({"prior": {"kind": "flat"}}, False),
        ({"basis": {"n_modes": 24, "k_max": 24, "m_max": 0}}, False),
        ({"basis": {"kind": "zernike", "max_degree": 6}}, True),
    ],
    ids=[
        "a round beam",
        "with a floor",
        "widths by the data",
        "without a prior",
        "round functions alone",
        "polynomials",
    ],
)
def test_functions_that_the_model_beam_lacks_are_told(changes: dict[str, Any], said: bool, tmp_path: Path) -> None:
    """An Airy beam has those of m = 0 alone."""
    job = mock_job(**{"basis": {"n_modes": 60, "k_max": 24, "m_max": 4}, **changes})
    if "kind" in job["basis"]:
        job["basis"] = changes["basis"]
    problem = context_of(job, tmp_path).problem
    told = [one for one in problem.cautions if one.startswith("The model beam has no part in")]
    assert len(told) == said
    if said:
        n_modes = problem.basis.n_modes
        n_round = sum(m == 0 for _, m in problem.basis.modes)
        assert f" {n_modes - n_round} of the {n_modes} functions" in told[0]
        assert "[prior] floor" in told[0]


@pytest.mark.parametrize(("seconds", "khz"), [(200.0, 100.0), (1.0, 5000.0), (1.0, 100.0)])
def test_what_means_over_integrations_and_channels_lose_is_told(seconds: float, khz: float, tmp_path: Path) -> None:
    """As by adding up the fringe of the fastest source, and that of one on the horizon."""
    problem = context_of(mock_job(), tmp_path).problem
    observation = replace(
        problem.observation,
        integration_time=np.full(problem.observation.Ntimes, seconds),
        channel_width=np.full(problem.observation.Nfreqs, 1e3 * khz),
    )
    places = dict(zip(observation.antenna_numbers.tolist(), observation.antpos, strict=True))
    vectors = np.array([places[two] - places[one] for one, two in observation.antpairs.tolist()]) / 299792458.0
    pole = np.array([0.0, np.cos(observation.latitude), np.sin(observation.latitude)])
    spread = np.linspace(-0.5, 0.5, 20001)
    rates = np.linalg.norm(np.cross(vectors, pole), axis=1) * 2 * np.pi / 86164.1 * observation.freqs[0]
    lost = [
        1 - abs(np.exp(2j * np.pi * spread * turns).mean())
        for turns in (rates.max() * seconds, np.linalg.norm(vectors, axis=1).max() * khz * 1e3)
    ]
    job = problem.job
    assert not any("a mean over" in one for one in cautions_of_data(job, observation))  # simulated: of one instant
    measured = job.model_copy(update={"data": job.data.model_copy(update={"simulate": None})})
    said = [one for one in cautions_of_data(measured, observation) if "a mean over" in one]
    assert len(said) == (max(lost) >= 0.01)
    for one in said:
        for length, part in ((f"{seconds:g} s", lost[0]), (f"{khz:g} kHz", lost[1])):
            assert (f"a mean over {length} loses up to {part:.0%}" in one) == (part >= 0.01)
            assert (f"a mean over {length}" in one) == (part >= 0.01)


def test_smearing_is_not_what_phased_data_are_told_to_use(tmp_path: Path) -> None:
    """What followed a place on the sky while it was averaged lost something else."""
    problem = context_of(mock_job(), tmp_path).problem
    integration_time = np.full(problem.observation.Ntimes, 200.0)
    observation = replace(problem.observation, integration_time=integration_time, is_phased=True)
    data = problem.job.data.model_copy(update={"simulate": None})
    said = [
        one for one in cautions_of_data(problem.job.model_copy(update={"data": data}), observation) if "mean" in one
    ]
    assert len(said) == 1
    assert "The files are phased: if they were averaged so" in said[0]
    assert "smearing = true" not in said[0]


def test_what_has_no_gains_is_told(tmp_path: Path) -> None:
    """Gains of the first half of the times, which are more than an integration apart from some of the others."""
    job = mock_job()
    problem = context_of(job, tmp_path).problem
    own = problem.observation
    first = replace(own, times=own.times[:3], lsts=own.lsts[:3], integration_time=own.integration_time[:3])
    gains = np.ones((own.Nfreqs, 3, own.Nants), dtype=complex)
    write_gains(tmp_path, first, gains, "")
    data = problem.job.data.model_copy(update={"gains": (str(tmp_path / "gains.cal*"),)})
    said = cautions_of_data(problem.job.model_copy(update={"data": data}), own)
    (told,) = [one for one in said if "gains" in one]
    assert "of all antennas at some times or channels: data of these count as flagged" in told
