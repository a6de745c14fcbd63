"""Gains that calibration finds beside a model of the visibilities."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.gain_solution import solved_gains

N_ANTENNAS = 9
ENDS = np.array([(i, j) for i in range(N_ANTENNAS) for j in range(i + 1, N_ANTENNAS)])


def sums_of(gains: np.ndarray, noise: float = 0.0, unlike: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return sum w d m* and sum w |m|^2 over twenty times of data with these gains, beside a model ``unlike`` them."""
    rng = np.random.default_rng(5)
    scatter = rng.normal(size=(3, 2, 20, len(ENDS)))
    model, other, own = scatter[:, 0] + 1j * scatter[:, 1]
    data = gains[ENDS[:, 0]] * gains[ENDS[:, 1]].conj() * (model + unlike * other) + noise * own
    return np.sum(data * model.conj(), axis=0), np.sum(np.abs(model) ** 2, axis=0)


def drawn() -> np.ndarray:
    rng = np.random.default_rng(2)
    return np.exp(0.2 * rng.normal(size=N_ANTENNAS) + 2j * np.pi * rng.uniform(size=N_ANTENNAS))


def without_common_phase(gains: np.ndarray) -> np.ndarray:
    return gains * np.exp(-1j * np.angle(gains[0]))


def test_gains_of_any_phase_come_back() -> None:
    found = solved_gains(*sums_of(drawn()), ENDS, N_ANTENNAS)
    np.testing.assert_allclose(without_common_phase(found), without_common_phase(drawn()), rtol=1e-8)
    assert np.angle(np.sum(found / np.abs(found))) == pytest.approx(0, abs=1e-12)


def test_they_are_the_best_beside_a_model_that_is_wrong() -> None:
    """No gain can be changed so that less is left."""
    overlap, model = sums_of(drawn(), noise=0.3, unlike=0.3)

    def left(gains: np.ndarray) -> float:
        factor = gains[ENDS[:, 0]] * gains[ENDS[:, 1]].conj()
        return float(np.sum(np.abs(factor) ** 2 * model - 2 * (factor.conj() * overlap).real))

    found = solved_gains(overlap, model, ENDS, N_ANTENNAS)
    for antenna in range(N_ANTENNAS):
        for change in (0.01, -0.01, 0.01j, -0.01j):
            assert left(found + change * (np.arange(N_ANTENNAS) == antenna)) > left(found)
    assert np.abs(without_common_phase(found) / without_common_phase(drawn()) - 1).max() < 0.5


def test_antennas_without_data_have_a_gain_of_one() -> None:
    overlap, model = sums_of(drawn())
    flagged = np.any(ENDS == 4, axis=1)
    found = solved_gains(np.where(flagged, 0, overlap), np.where(flagged, 0, model), ENDS, N_ANTENNAS)
    assert found[4] == 1
    others = np.delete(drawn(), 4)
    np.testing.assert_allclose(without_common_phase(np.delete(found, 4)), without_common_phase(others), rtol=1e-8)
    np.testing.assert_array_equal(solved_gains(0 * overlap, 0 * model, ENDS, N_ANTENNAS), np.ones(N_ANTENNAS))
