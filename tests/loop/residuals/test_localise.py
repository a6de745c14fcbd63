from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.loop.residuals.localise import where
from tests.loop.white import make_layout, noise, sums_of

LAYOUT = make_layout()
OBSERVATION = LAYOUT.observation


def found_in(z: np.ndarray) -> dict[str, Any]:
    found = where(sums_of(LAYOUT, z), LAYOUT)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    return found


def whats(found: dict[str, Any], axis: str) -> list[Any]:
    assert found[axis]["state"] == "concentrated", found["sentence"]
    return [entry["what"] for entry in found[axis]["entries"]]


def states(found: dict[str, Any]) -> dict[str, str]:
    return {axis: entry["state"] for axis, entry in found.items() if axis != "sentence"}


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_everywhere(seed: int) -> None:
    found = found_in(noise(LAYOUT, seed))
    assert set(states(found).values()) == {"even"}
    assert "nowhere" in found["sentence"]


@pytest.mark.parametrize("strength", [0.5, 1.0, 30.0])
def test_an_antenna(strength: float) -> None:
    z = noise(LAYOUT)
    z[:, :, (LAYOUT.observation.antenna_index == 2).any(axis=1)] += strength * noise(LAYOUT, 1)[:, :, :6]
    found = found_in(z)
    number = int(OBSERVATION.antenna_numbers[2])
    assert whats(found, "antennas") == [number]
    assert f"on 1 of 7 antennas ({number})" in found["sentence"]
    assert found["times"]["state"] == found["freqs"]["state"] == "even"


def test_two_times() -> None:
    z = noise(LAYOUT)
    z[:, 7:9] += noise(LAYOUT, 1)[:, 7:9]
    found = found_in(z)
    jds = OBSERVATION.times[LAYOUT.times[7:9]]
    assert sorted(what["jd"] for what in whats(found, "times")) == jds.tolist()
    assert "in 2 of 20 times (LST 4." in found["sentence"]
    assert states(found)["antennas"] == "even"
    assert sum(entry["share"] for entry in found["times"]["entries"]) > 2 / 3


def test_times_apart() -> None:
    z = noise(LAYOUT)
    z[:, [0, 19]] += 2 * noise(LAYOUT, 1)[:, :2]
    assert "in 2 of 20 times (LST 3.08, 7.83 h)" in found_in(z)["sentence"]


def test_times_about_the_origin_of_lst() -> None:
    layout = make_layout(lst_range=(22.0, 3.0))
    z = noise(layout)
    z[:, 6:10] += 2 * noise(layout, 1)[:, :4]
    assert "in 4 of 20 times (LST 23.58-0.33 h)" in where(sums_of(layout, z), layout)["sentence"]


def test_a_visibility() -> None:
    z = noise(LAYOUT)
    z[3, 5, 13] = 200.0
    found = found_in(z)
    assert whats(found, "baselines") == [OBSERVATION.antpairs[13].tolist()]
    assert [what["jd"] for what in whats(found, "times")] == [OBSERVATION.times[LAYOUT.times[5]]]
    assert whats(found, "freqs") == [OBSERVATION.freqs[3]]


def test_a_channel() -> None:
    z = noise(LAYOUT)
    z[4] += noise(LAYOUT, 1)[4]
    found = found_in(z)
    assert whats(found, "freqs") == [OBSERVATION.freqs[4]]
    assert "in 1 of 6 channels (133 MHz)" in found["sentence"]
    assert states(found)["delays"] == states(found)["baselines"] == "even"


def test_a_constant_of_each_baseline() -> None:
    z = noise(LAYOUT) + noise(LAYOUT, 1)[:, :1] * 0.7
    found = found_in(z)
    assert whats(found, "fringe_rates") == [0.0]
    assert "fringe rates near zero" in found["sentence"]
    assert states(found)["times"] == "even"


def test_a_fringe_rate() -> None:
    rate = float(LAYOUT.fringe_rates.values[4])
    seconds = 86400 * OBSERVATION.times[LAYOUT.times]
    tone = np.exp(2j * np.pi * rate * (seconds - seconds[0]))[:, np.newaxis]
    found = found_in(noise(LAYOUT) + 0.7 * tone * noise(LAYOUT, 1)[:, :1])
    np.testing.assert_allclose(whats(found, "fringe_rates"), [rate], rtol=1e-6)
    assert "mHz" in found["sentence"]


def test_a_delay() -> None:
    delay = float(LAYOUT.delays.values[2])
    tone = np.exp(2j * np.pi * delay * OBSERVATION.freqs)[:, np.newaxis, np.newaxis]
    found = found_in(noise(LAYOUT) + 0.7 * tone * noise(LAYOUT, 1)[:1])
    np.testing.assert_allclose(whats(found, "delays"), [delay])
    assert "ns" in found["sentence"]


def test_a_baseline() -> None:
    z = noise(LAYOUT)
    z[:, :, 13] += 2 * noise(LAYOUT, 1)[:, :, 13]
    found = found_in(z)
    assert whats(found, "baselines") == [OBSERVATION.antpairs[13].tolist()]
    assert "on 1 of 21 baselines" in found["sentence"]


def test_a_baseline_that_noise_hides_from_the_sum() -> None:
    """Many baselines, one of them with an excess that is less than the scatter of all together."""
    layout = make_layout(n_freqs=1, hexagon=(3, 5))
    z = noise(layout, 3)
    baseline = 50
    z[:, :, baseline] *= 2
    found = where(sums_of(layout, z), layout)
    assert whats(found, "baselines")[0] == layout.observation.antpairs[baseline].tolist()


def test_a_length() -> None:
    longest = np.linalg.norm(OBSERVATION.bl_vectors, axis=1)
    z = noise(LAYOUT)
    chosen = longest > 0.99 * longest.max()
    z[:, :, chosen] += noise(LAYOUT, 1)[:, :, chosen]
    found = found_in(z)
    assert whats(found, "lengths") == pytest.approx([longest.max()], abs=1e-3)


def test_redundant_baselines_share_what_is_of_the_beam_and_the_sky() -> None:
    z, group = noise(LAYOUT), LAYOUT.redundant.group
    of_groups = noise(LAYOUT, 1)[:, :, group]
    assert "Redundant baselines share it (" in found_in(z + of_groups)["sentence"]
    own = 2 * noise(LAYOUT, 2)
    assert "Redundant baselines do not share it (" in found_in(z + own)["sentence"]
    assert "Redundant baselines share a part of it (" in found_in(z + own + 3 * of_groups)["sentence"]


def test_nothing_is_said_of_redundant_baselines_in_noise_or_where_there_are_none() -> None:
    assert "edundant baselines" not in found_in(noise(LAYOUT))["sentence"]
    apart = OBSERVATION.bl_vectors + np.arange(OBSERVATION.Nbls)[:, np.newaxis]
    alone = replace(LAYOUT, redundant=find_redundant_groups(apart, 1e-3))
    assert "edundant baselines" not in where(sums_of(alone, 3 * noise(alone)), alone)["sentence"]


def test_one_antenna_above_noise_that_was_overestimated() -> None:
    z = 0.6 * noise(LAYOUT)
    z[:, :, (LAYOUT.observation.antenna_index == 2).any(axis=1)] *= 2
    found = found_in(z)
    assert whats(found, "antennas") == [OBSERVATION.antenna_numbers[2]]
    assert sum(entry["share"] for entry in found["antennas"]["entries"]) == pytest.approx(1.0)


def test_excess_everywhere_is_concentrated_nowhere() -> None:
    found = found_in(3 * noise(LAYOUT))
    assert set(states(found).values()) == {"even"}
