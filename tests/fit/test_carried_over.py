"""A joint Gaussian of beam and effects, in data that have some of its effects."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.carried_over import carry_over
from tests.effects.small import small_setup

N = 4
"""Coefficients of the beam."""
SETUP = small_setup((131e6,), 2, 5)
ANTENNAS = SETUP.observation.antenna_numbers.tolist()


def gains(antennas: list[int], known: list[int], width: float = 0.2) -> dict[str, Any]:
    """Return an entry of ``posterior.h5``: gains of some antennas, of those ``known`` to the result."""
    names = [f"antenna {ant} {what}" for ant in antennas for what in ("ln amplitude", "phase")]
    values = (0.01 * np.arange(1, 1 + len(names))).tolist()
    return {
        "kind": "antenna_gains",
        "names": names,
        "index": list(range(len(names))),
        "values": [values],
        "std": [[0.1] * len(names)],
        "prior_std": [[width] * len(names)],
        "known": [f"antenna {ant} {what}" for ant in known for what in ("ln amplitude", "phase")],
    }


def joint(q: int) -> FloatArray:
    """Return a covariance of beam and effects, (N + q, N + q)."""
    root = np.random.default_rng(7).standard_normal((N + q, N + q))
    return root @ root.T + 0.1 * np.eye(N + q)


def arrays_of(covariance: FloatArray) -> dict[str, FloatArray]:
    effects = covariance[N:, N:]
    return {"effects_covariance": effects, "effects_beam_response": covariance[:N, N:] @ np.linalg.inv(effects)}


@pytest.mark.parametrize("lacking", [[], [ANTENNAS[2]], ANTENNAS[1:4]])
def test_what_is_left_has_its_marginal(lacking: list[int]) -> None:
    """Antennas that these data lack come first, so that all others have other numbers here."""
    gone = [1000 + ant for ant in lacking]
    antennas = [*gone, *(ant for ant in ANTENNAS if ant not in lacking)]
    carried = carry_over([gains(antennas, antennas)], SETUP)
    covariance = joint(2 * len(antennas))
    beam, effects, response = carried.fit(0, np.arange(N), covariance[:N, :N], arrays_of(covariance))

    (active,) = carried.values.active
    names = [active.effect.parameters(SETUP).names[i] for i in active.used]
    told = gains(antennas, antennas)
    place = [names.index(name) for name in told["names"] if name in names]
    there = [number for number, name in enumerate(told["names"]) if name in names]
    marginal = covariance[np.ix_([*range(N), *(N + np.array(there))], [*range(N), *(N + np.array(there))])]
    np.testing.assert_array_equal(active.x[0, active.used][place], np.array(told["values"][0])[there])
    np.testing.assert_allclose(effects[np.ix_(place, place)], marginal[N:, N:], rtol=1e-9)
    np.testing.assert_allclose((response @ effects)[:, place], marginal[:N, N:], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(beam.covariance + response @ effects @ response.T, marginal[:N, :N], rtol=1e-8)

    at_prior = [names.index(f"antenna {ant} {what}") for ant in lacking for what in ("ln amplitude", "phase")]
    np.testing.assert_allclose(effects[at_prior][:, at_prior], 0.04 * np.eye(len(at_prior)), rtol=1e-12)
    assert not response[:, at_prior].any()
    assert not active.x[0, active.used][at_prior].any()
    assert carried.at_prior == tuple(f"antenna gains: {names[i]}" for i in sorted(at_prior))
    assert [one for left in carried.left for one in left["parameters"]] == told["names"][: 2 * len(lacking)]


def test_a_further_antenna_is_as_the_others_where_few_were_at_fault() -> None:
    carried = carry_over([gains([ANTENNAS[3]], ANTENNAS[1:])], SETUP)
    assert carried.at_prior == ()
    assert carried.left == ()
    assert carried.values.active[0].size == 2


def test_a_baseline_in_the_other_sense_has_the_conjugate() -> None:
    one, two = SETUP.observation.antenna_numbers[SETUP.antenna_index][5].tolist()
    told = gains([1], [1]) | {
        "kind": "cross_coupling",
        "settings": {"baselines": [[two, one]]},
        "names": [f"baseline {two}-{one} real", f"baseline {two}-{one} imaginary"],
    }
    carried = carry_over([told], SETUP)
    np.testing.assert_array_equal(carried.values.active[0].x, [[0.01, -0.02]])
    _, effects, _ = carried.fit(0, np.zeros(N), joint(2)[:N, :N], arrays_of(joint(2)))
    np.testing.assert_allclose(effects, joint(2)[N:, N:] * [[1, -1], [-1, 1]], rtol=1e-12)


def test_what_is_of_a_single_time_holds_at_that_time() -> None:
    """Of further times nothing is known but how large it is."""
    jds = SETUP.observation.times[SETUP.times]
    names = [f"antenna {ANTENNAS[2]} phase at JD {jd:.5f}" for jd in (*jds[:2], jds[0] + 1)]
    told = gains([1], [1]) | {
        "kind": "gain_jitter",
        "settings": {"gains_of": [[ANTENNAS[2], "phase"], [1000, "phase"]]},
        "names": names,
        "index": [0, 1, 2],
        "values": [[0.01, 0.02, 0.03]],
        "std": [[0.1] * 3],
        "prior_std": [[0.2] * 3],
        "known": names,
    }
    carried = carry_over([told], SETUP)
    (active,) = carried.values.active
    x = np.zeros((1, len(jds)))
    x[0, :2] = 0.01, 0.02
    np.testing.assert_array_equal(active.x, x)
    assert [one["parameters"] for one in carried.carried] == [names[:2]]
    assert [one["parameters"] for one in carried.left] == [names[2:]]
    covariance = joint(3)
    _, effects, _ = carried.fit(0, np.zeros(N), covariance[:N, :N], arrays_of(covariance))
    np.testing.assert_allclose(effects[:2, :2], covariance[N:-1, N:-1], rtol=1e-12)
    np.testing.assert_allclose(effects[2:, 2:], 0.04 * np.eye(len(jds) - 2), rtol=1e-12)


def test_nothing_is_left_of_single_times_and_of_noise() -> None:
    times = gains([1], [1]) | {"kind": "ionosphere"}
    noise = {"kind": "noise_level", "values": [[1.5]], "std": [[0.1]]}
    carried = carry_over([times, noise], replace(SETUP, times=np.arange(1)))
    assert not carried.values.active
    assert [one["effect"] for one in carried.left] == ["ionosphere", "noise_level"]
    assert carried.left[0]["reason"] == "belongs to times of the data in which it was found"
    covariance = joint(2)
    beam, effects, response = carried.fit(0, np.zeros(N), covariance[:N, :N], arrays_of(covariance))
    np.testing.assert_allclose(beam.covariance, covariance[:N, :N], rtol=1e-9)
    assert effects.shape == (0, 0)
    assert response.shape == (N, 0)


@pytest.mark.parametrize("change", [{"kind": "antenna_gain"}, {"values": []}, {"index": [1]}, {"names": 3}])
def test_what_is_no_effect_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="effects, number 1"):
        carry_over([gains([1], [1]) | change], SETUP)


def test_what_is_no_joint_covariance_is_refused() -> None:
    carried = carry_over([gains(ANTENNAS, ANTENNAS)], SETUP)
    covariance = joint(2 * len(ANTENNAS))
    with pytest.raises(InputError, match="is no covariance"):
        carried.fit(0, np.zeros(N), 0.01 * covariance[:N, :N], arrays_of(covariance))
    with pytest.raises(InputError, match="fewer effects"):
        carried.fit(0, np.zeros(N), covariance[:N, :N], arrays_of(covariance[:-1, :-1]))
