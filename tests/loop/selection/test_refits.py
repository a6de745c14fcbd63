"""Priors of effects that are fitted again."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.loop.selection.refits import is_same_prior


@pytest.mark.parametrize(
    ("factor", "same"), [(1.0, True), (1.9, True), (1 / 1.9, True), (2.1, False), (1 / 2.1, False), (1e-8, False)]
)
def test_priors_are_the_same_within_a_factor_of_two_either_way(factor: float, same: bool) -> None:
    variances = np.array([0.0, 1e-6, 3.0])
    assert is_same_prior(factor * variances, variances) is same


def test_priors_of_other_parameters_are_not_the_same() -> None:
    assert not is_same_prior(np.array([0.0, 1.0]), np.array([1.0, 1.0]))
