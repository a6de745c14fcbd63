"""What stands out among many, and what does not."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.inference.robust import log_odds_of_wide, outliers


@pytest.mark.parametrize(
    ("n", "spread"), [(5, 0.01), (5, 0.5), (7, 0.5), (37, 0.01), (37, 0.5), (37, 1.0), (37, 3.0), (350, 3.0)]
)
def test_healthy_values_do_not_stand_out(n: int, spread: float) -> None:
    rng = np.random.default_rng(1)
    assert not any(outliers(spread * rng.normal(size=n)).any() for _ in range(200))


def test_what_is_dead_stands_out_beside_what_is_unknown() -> None:
    values = np.array([0.1, -0.2, np.nan, -12.7, 0.3, -np.inf, 0.0, 0.2])
    assert np.flatnonzero(outliers(values)).tolist() == [3, 5]
    assert not outliers(values, error=10.0)[3]


def test_of_few_or_mostly_dead_values_none_stands_out() -> None:
    assert not outliers(np.array([0.0, 0.1, 0.2, -50.0])).any()
    assert not outliers(np.array([0.0, 0.1, -np.inf, -np.inf, -np.inf])).any()


def test_odds_are_those_of_the_two_gaussians() -> None:
    """ln N(x; 0, 3^2 + 0.4^2) - ln N(x; 0, 0.3^2 + 0.4^2), the latter of width 0.5."""
    wide = 9.16
    expected = 0.5 * (2.0**2 / 0.25 - 2.0**2 / wide) + 0.5 * np.log(0.25 / wide)
    assert log_odds_of_wide(2.0, 0.4, 0.3, 3.0) == pytest.approx(expected, rel=1e-12)
    assert log_odds_of_wide(0.0, 0.4, 0.3, 3.0) < 0 < log_odds_of_wide(-2.0, 0.4, 0.3, 3.0)
