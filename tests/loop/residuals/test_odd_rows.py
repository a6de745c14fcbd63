"""Integrations, antennas and baselines that are off after a fit are named, each with the key that leaves it out."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from hydrabeam_mpi.config.data import Data
from hydrabeam_mpi.data.observation import ComplexArray, Observation
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.io.uvmeta import read_observation
from hydrabeam_mpi.loop.residuals.odd_rows import RowPower, odd_rows
from hydrabeam_mpi.setup.findings import Finding
from tests.visibilities import SECOND, make_uvdata

N_TIMES = 20


@pytest.fixture(scope="module")
def observation(tmp_path_factory: pytest.TempPathFactory) -> Observation:
    """Of a dozen antennas with numbers from 3 on."""
    path = tmp_path_factory.mktemp("odd") / "a.uvh5"
    times = 2459866.2 + 10 * SECOND * np.arange(N_TIMES)
    make_uvdata(times=times).write_uvh5(str(path), run_check=False)
    numbers = 3 + np.arange(12)
    return replace(
        read_observation([path], Selection()),
        antenna_numbers=numbers,
        antpos=np.random.default_rng(1).normal(size=(12, 3)),
        antpairs=np.array(list(combinations(numbers.tolist(), 2))),
    )


def noise(observation: Observation, seed: int = 1) -> ComplexArray:
    """Whitened residuals of a channel, (Ntimes, Nbls)."""
    shape = observation.Ntimes, observation.Nbls
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def told(z: ComplexArray, observation: Observation) -> list[Finding]:
    """What is said if every other integration is fitted, and explained twice as well as the others."""
    power, times, bls = RowPower.zeros(observation), np.arange(N_TIMES), np.arange(observation.Nbls)
    power.add(0, times[::2], bls, z[::2] / 2)
    power.add(1, times[1::2], bls, z[1::2])
    return list(odd_rows(power, observation))


def test_noise_is_not_odd(observation: Observation) -> None:
    for seed in range(20):
        assert told(noise(observation, seed), observation) == []


def test_integrations_can_be_left_out_by_the_key_that_is_given(observation: Observation) -> None:
    z, bad = noise(observation), [4, 7]
    z[bad] *= 10
    found = told(z, observation)
    assert [one.what for one in found] == ["an integration that stands out"] * 2
    assert [", fitted (" in one.why for one in found] == [True, False]
    assert [", held out (" in one.why for one in found] == [False, True]
    for one, t in zip(found, bad, strict=True):
        assert one.where == f"JD {observation.times[t]:.6f}"
        (span,) = json.loads(one.remedy.partition(" = ")[2].partition(" in [data]")[0])
        given = Data(files=("a",), exclude_times=(tuple(span),))
        excluded = replace(observation, exclude_times=given.exclude_times)
        gone = excluded.excluded(np.arange(observation.Ntimes), observation.antpairs).all(axis=1)
        assert np.flatnonzero(gone).tolist() == [t]


def test_an_antenna_stands_for_its_baselines(observation: Observation) -> None:
    z = noise(observation)
    z[:, (observation.antpairs == 7).any(axis=1)] *= 10
    (one,) = told(z, observation)
    assert one.remedy == "if it is bad, exclude_antennas = [7] in [data]"


def test_a_baseline_stands_for_itself(observation: Observation) -> None:
    z = noise(observation)
    z[:, (observation.antpairs == [3, 7]).all(axis=1)] *= 10
    (one,) = told(z, observation)
    assert one.remedy == "if it is bad, exclude_baselines = [[3, 7]] in [data]"


def test_baselines_among_few_antennas_are_no_bad_antennas(observation: Observation) -> None:
    z = noise(observation)
    bad = np.isin(observation.antpairs, [3, 7, 9]).all(axis=1)
    z[:, bad] *= 30
    found = told(z, observation)
    assert [one.what for one in found] == ["a baseline that stands out"] * 3
    assert [one.where for one in found] == ["baseline 3-7", "baseline 3-9", "baseline 7-9"]


@pytest.mark.parametrize("axis", [0, 1])
def test_what_is_uneven_everywhere_is_not_odd(axis: int, observation: Observation) -> None:
    """An effect that nobody knows, in all integrations or baselines, of some ten times the power in some."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        shape = (N_TIMES, 1) if axis == 0 else (1, observation.Nbls)
        assert told(noise(observation, seed) * np.exp(rng.normal(0, 1, shape)), observation) == []
