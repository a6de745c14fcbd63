"""Draws of a Gaussian where combinations of its unknowns are not negative."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import ks_2samp

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.inference.nonnegative import NonNegative
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.random import complex_normal, generator

FALSE_ALARM = 1e-3
"""Probability that right draws fail a case, were their seed another one."""


def case(is_complex: bool) -> tuple[Posterior, NonNegative]:
    """Three unknowns; five combinations that hold together somewhere but not at the mean, and one that is nothing."""
    rng = generator(1, "case", is_complex)
    shape = (6, 3)
    rows = complex_normal(rng, shape) if is_complex else rng.standard_normal(shape)
    inside = rows[0].conj()
    rows *= np.sign((rows @ inside).real)[:, np.newaxis]
    rows[-1] = 0
    square = complex_normal(rng, (3, 3)) if is_complex else rng.standard_normal((3, 3))
    factor = np.linalg.cholesky(square @ square.conj().T + 0.5 * np.eye(3))
    mean = 0.6 * inside - 0.4 * rows[1].conj()
    return Posterior(mean, factor), NonNegative(rows)


def features(draws: Array, positive: NonNegative) -> Array:
    """Return numbers of draws whose distributions are compared: unknowns, and combinations."""
    parts = [draws.real, draws.imag] if np.iscomplexobj(draws) else [draws]
    return np.concatenate([*parts, (draws @ positive.rows[:-1].T).real], axis=1).T


@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
def test_draws_are_those_that_rejection_leaves(is_complex: bool) -> None:
    posterior, positive = case(is_complex)
    every = posterior.draws([generator(2, number) for number in range(20000)])
    left = every[((every @ positive.rows.T).real >= 0).all(axis=1)]
    assert 100 < len(left) < 0.5 * len(every), "the combinations hold nearly always, or never"
    state, found = positive.nearest(posterior, posterior.mean), []
    for number in range(4000):
        state = positive.draw(posterior, state, generator(3, number))
        assert positive.holds(state)
        found.append(state)
    pairs = list(zip(features(np.array(found[::10]), positive), features(left, positive), strict=True))
    assert min(ks_2samp(*pair).pvalue for pair in pairs) > FALSE_ALARM / len(pairs)


@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
def test_without_a_combination_in_reach_a_draw_is_one_of_the_gaussian(is_complex: bool) -> None:
    """With the same random numbers."""
    posterior, positive = case(is_complex)
    far = Posterior(1e3 * positive.rows[0].conj(), posterior.factor)
    positive = NonNegative(positive.rows[:1])
    drawn = positive.draw(far, far.mean, generator(4))
    np.testing.assert_allclose(drawn, far.draw(generator(4)), rtol=1e-12)


@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
def test_the_nearest_is_that_of_a_general_minimiser(is_complex: bool) -> None:
    posterior, positive = case(is_complex)
    start = posterior.draw(generator(5))

    def unknowns(parts: Array) -> Array:
        return np.asarray(parts[:3] + 1j * parts[3:] if is_complex else parts)

    def distance(parts: Array) -> float:
        return float(np.sum(np.abs(posterior.factor.conj().T @ (unknowns(parts) - start)) ** 2))

    holds = {"type": "ineq", "fun": lambda parts: positive.values(unknowns(parts))}
    begun = np.concatenate([start.real, start.imag]) if is_complex else start
    told = minimize(distance, begun, method="SLSQP", constraints=[holds], options={"ftol": 1e-14, "maxiter": 300})
    assert not positive.holds(start)
    np.testing.assert_allclose(positive.nearest(posterior, start), unknowns(told.x), atol=1e-5)
