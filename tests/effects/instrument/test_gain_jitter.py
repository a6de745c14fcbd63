from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi import InputError
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.gain_jitter import MOST_COLUMNS, GainJitter
from tests.effects.small import small_block, small_setup


def test_at_each_time_it_is_a_gain() -> None:
    setup = small_setup(n_times=5)
    block = small_block(setup)
    one, two = (int(setup.observation.antenna_numbers[i]) for i in (1, 4))
    effect = GainJitter([(two, "phase"), (one, "ln amplitude"), (one, "phase")])
    x = np.linspace(-0.4, 0.5, 15)
    phase_of_two, ln_of_one, phase_of_one = x.reshape(3, 5)
    for t in range(5):
        gains = np.zeros((setup.observation.Nants, 2))
        gains[1], gains[4, 1] = (ln_of_one[t], phase_of_one[t]), phase_of_two[t]
        expected = AntennaGains().factor(block.at_time(t), gains.ravel())
        np.testing.assert_allclose(effect.factor(block.at_time(t), x), expected, rtol=1e-14)
        np.testing.assert_allclose(effect.factor(block, x)[t], expected[0], rtol=1e-14)


def test_a_time_says_nothing_of_the_next() -> None:
    setup = small_setup(n_times=5)
    block = small_block(setup)
    effect = GainJitter([(int(setup.observation.antenna_numbers[2]), "phase")])
    x = np.array([0.0, 0.0, 0.3, 0.0, 0.0])
    changed = np.abs(effect.factor(block, x) - 1) > 1e-9
    np.testing.assert_array_equal(np.flatnonzero(changed.any(axis=1)), [2])
    np.testing.assert_array_equal(changed[2], np.any(setup.antenna_index[block.bls] == 2, axis=1))


def test_times_need_not_be_in_order() -> None:
    setup = replace(small_setup(n_times=5), times=np.array([3, 0, 4]))
    block = small_block(setup)
    number = int(setup.observation.antenna_numbers[2])
    effect, x = GainJitter([(number, "phase")]), np.array([0.3, 0.1, -0.2])
    names = effect.parameters(setup).names
    assert names == tuple(f"antenna {number} phase at JD {setup.observation.times[t]:.5f}" for t in (3, 0, 4))
    at_all = np.zeros(5)
    at_all[setup.times] = x
    np.testing.assert_allclose(np.angle(effect.gains(setup, 0, x)[:, 2]), at_all, atol=1e-14)
    row = np.flatnonzero(block.ant1 == 2)[0]
    for t in setup.times:
        assert np.angle(effect.factor(block.at_time(t), x)[0, row]) == pytest.approx(at_all[t], abs=1e-14)


def test_what_all_phases_have_in_common_cancels() -> None:
    setup = small_setup(n_times=4)
    block = small_block(setup)
    every = GainJitter().at(setup, np.arange(GainJitter().n_hypotheses(setup)))
    held = every.degenerate_directions(setup)
    assert held.shape == (4, len(every.parameters(setup)))
    np.testing.assert_allclose(held @ held.T, np.eye(4), atol=1e-14)
    for one in held:
        np.testing.assert_allclose(every.factor(block, one), 1, atol=1e-14)


def test_a_sign_that_is_lost_at_a_time_needs_its_phase() -> None:
    """Which the effect gets where it has none."""
    setup = small_setup(n_times=4)
    one, two = (int(setup.observation.antenna_numbers[i]) for i in (1, 4))
    effect = GainJitter([(one, "ln amplitude"), (two, "ln amplitude"), (two, "phase")])
    x = np.array([0.1, -2.0, 0.0, -0.5, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0, 0.0, 0.2])
    more, own, needed = effect.needed_at(setup, x)
    assert isinstance(more, GainJitter)
    assert more.gains_of == (*effect.gains_of, (one, "phase"))
    np.testing.assert_array_equal(own, np.arange(12))
    np.testing.assert_array_equal(np.flatnonzero(needed), [10, 13])
    begun = more.begun(setup, np.append(x, np.zeros(4)))
    np.testing.assert_allclose(begun[[1, 6, 10, 13]], [0.0, np.log(2), np.pi, np.pi])


def test_phases_that_jump_by_nearly_half_a_turn_are_told_either_way_round() -> None:
    """And are one jump, whatever is said of a time that no data tell."""
    setup = small_setup(n_times=12)
    number = int(setup.observation.antenna_numbers[1])
    x, std = np.zeros((2, 12)), np.full((2, 12), 1e-3)
    x[:, 6:] = [3.1, 3.1 - 2 * np.pi, 3.1, 3.1, 0.0, 3.1]
    std[:, 10] = 2.0
    jumps, drift = GainJitter([(number, "phase")]).simpler_elements(setup, x, std)
    which, effect, begun = jumps
    assert which.all()
    assert effect.law == "piecewise"
    assert drift[1].law == "smooth"
    names = effect.parameters(setup).names
    (used,) = np.flatnonzero(begun)
    assert names[used].startswith(f"antenna {number} phase, jump at JD {setup.observation.times[5:7].mean():.4f}")
    assert begun[used] == pytest.approx(3.1, abs=1e-5)


@pytest.mark.parametrize("n_times", [4, 200, 600])
def test_as_many_are_weighed_together_as_there_is_room_for(n_times: int) -> None:
    """All of a small array, or those that explain most: a part that is left out would pass for drifts of the rest."""
    setup = small_setup(n_times=n_times)
    order = np.random.default_rng(1).permutation(GainJitter().n_hypotheses(setup))
    every = [GainJitter().at(setup, np.array([one])).gains_of[0] for one in order]
    taken = GainJitter().at(setup, order).gains_of
    assert len(taken) == max(min(len(every), MOST_COLUMNS // n_times), 1)
    assert list(taken) == every[: len(taken)]
    assert (len(taken) == len(every)) == (n_times == 4)


@pytest.mark.parametrize(
    ("gains_of", "said"),
    [
        ([(999, "phase")], "no baseline has antenna 999"),
        ([(0, "phase"), (0, "phase")], "antenna 0 phase is named twice"),
    ],
)
def test_antennas_that_are_not_there_or_named_twice(gains_of: list[tuple[int, str]], said: str) -> None:
    setup = small_setup(n_times=4)
    numbers = setup.observation.antenna_numbers
    gains_of = [(int(numbers[number]) if number < 999 else number, part) for number, part in gains_of]
    said = said.replace("antenna 0", f"antenna {numbers[0]}")
    with pytest.raises(InputError, match=said):
        GainJitter(gains_of).columns(small_block(setup), np.zeros(0))  # type: ignore[arg-type]


def test_of_too_many_integrations_it_is_not_looked_for() -> None:
    setup = small_setup(n_times=4)
    assert GainJitter().not_applicable(setup) is None
    many = replace(setup, times=np.tile(setup.times, 200), fitted=None)
    assert "600" in str(GainJitter().not_applicable(many))
