"""Gains are weighed as each channel's own, and as the same in all: whichever has more evidence is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute
from tests.loop.mock import context_of, mock_job

CHANNELS = (131e6, 131.1e6, 131.2e6, 131.3e6)


def weighed(folder: Path, freqs: tuple[float, ...], **effect: Any) -> Finding:
    context = context_of(mock_job({"kind": "antenna_gains", **effect}, freqs=freqs), folder)
    (found,) = attribute(context, refit(context, Values()), [AntennaGains()])
    return found


def test_what_all_channels_have_alike_takes_one_number(tmp_path: Path) -> None:
    found = weighed(tmp_path, CHANNELS, parameters={"antenna 3 ln amplitude": 0.01})
    assert found.effect.describe() == {"channels": "alike"}
    assert found.evidence.n_parameters == 1
    assert found.evidence.x[0, 6] == pytest.approx(0.01, abs=0.001)


def test_what_each_channel_has_of_its_own_does_not(tmp_path: Path) -> None:
    found = weighed(tmp_path, CHANNELS, strength=0.01)
    assert found.effect.describe() == {}
    assert found.evidence.x.shape[0] == len(CHANNELS)


def test_one_channel_has_its_own(tmp_path: Path) -> None:
    found = weighed(tmp_path, CHANNELS[:1], parameters={"antenna 3 ln amplitude": 0.01})
    assert found.effect.describe() == {}
