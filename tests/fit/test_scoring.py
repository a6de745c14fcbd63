"""Fisher scoring finds the maximum of a likelihood within bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.scoring import ENOUGH, Told, highest

FREE = np.array([[-20.0] * 3, [20.0] * 3])


class Variances:
    """ln of the variances of three sets of Gaussian numbers, of which the second has the first one's added to it."""

    def __init__(self, n_each: int, true: FloatArray) -> None:
        rng = np.random.default_rng(3)
        self.mixing = np.array([[1.0, 0, 0], [1, 1, 0], [0, 0, 1]])
        self.n, self.asked = n_each, 0
        self.power = np.mean(
            (np.sqrt(self.mixing @ np.exp(true))[:, np.newaxis] * rng.standard_normal((3, n_each))) ** 2, 1
        )

    def __call__(self, numbers: FloatArray) -> Told:
        self.asked += 1
        variance = self.mixing @ np.exp(numbers)
        slopes = self.mixing * np.exp(numbers) / variance[:, np.newaxis]
        value = -0.5 * self.n * np.sum(np.log(variance) + self.power / variance)
        gradient = 0.5 * self.n * slopes.T @ (self.power / variance - 1)
        return Told(float(value), gradient, 0.5 * self.n * slopes.T @ slopes)


@pytest.mark.parametrize("begin", [[0.0, 0.0, 0.0], [9.0, -9.0, 5.0], [-9.0, 9.0, -9.0]])
def test_the_maximum_is_found_from_near_and_far(begin: list[float]) -> None:
    """In few steps, to what no decision hangs on."""
    told = Variances(200, np.array([-2.0, 1.0, 4.0]))
    at, value = highest(told, np.array(begin), FREE)
    assert told.asked < 40
    best = minimize(lambda x: -told(x).value, at, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-9})
    assert -best.fun - value < 2 * ENOUGH
    assert np.all(np.abs(at - best.x) < 0.5 / np.sqrt(np.diag(told(best.x).information)))


def test_bounds_hold_and_what_is_not_free_stays() -> None:
    told = Variances(200, np.array([-2.0, 1.0, 4.0]))
    bounds = np.array([[-20.0, 1.5, 3.0], [20.0, 1.5, 3.5]])
    at, value = highest(told, np.zeros(3), bounds)
    assert at[1] == 1.5
    assert at[2] == 3.5
    best = minimize(lambda x: -told(np.array([x[0], 1.5, 3.5])).value, at[:1], method="Nelder-Mead")
    assert -best.fun - value < 2 * ENOUGH


def test_where_it_begins_is_where_it_ends_if_that_is_the_maximum() -> None:
    told = Variances(200, np.array([-2.0, 1.0, 4.0]))
    at, _ = highest(told, np.zeros(3), FREE)
    told.asked = 0
    again, _ = highest(told, at, FREE)
    np.testing.assert_array_equal(again, at)
    assert told.asked == 1
