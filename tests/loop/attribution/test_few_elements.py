"""Which elements are at fault, where some look like others together."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.effects.interface.effect import Parameters
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.evidence import find_evidence
from hydrabeam_mpi.loop.attribution.few_elements import (
    TAUS,
    TRIED_AT_ONCE,
    _best_element,
    _element_gains,
    _members,
)
from hydrabeam_mpi.loop.attribution.price import rarity
from hydrabeam_mpi.random import generator

N_DATA = 60


def elements(n: int, each: int, trials: int | None = None) -> Parameters:
    names = [f"p{i}" for i in range(n * each)]
    return Parameters.of(names, "", 1.0, np.repeat(np.arange(n), each), trials=trials)


@pytest.mark.parametrize("each", [1, 2])
@pytest.mark.parametrize("trials", [None, 300])
def test_one_that_stands_for_two_is_not_taken(each: int, trials: int | None) -> None:
    """It explains more than either of the two that are at fault, so that it comes first where they come one by one."""
    rng = generator(3, "stands for two")
    columns = rng.standard_normal((N_DATA, 12, each))
    columns[:, 0] = columns[:, 4] + columns[:, 9] + 0.3 * rng.standard_normal((N_DATA, each))
    data = (columns[:, 4] + columns[:, 9]).sum(axis=1) * 5 + rng.standard_normal(N_DATA)
    columns = columns.reshape(N_DATA, -1)
    signal, parameters = columns.T @ columns, elements(12, each, trials)
    found = find_evidence([Likelihood(signal, columns.T @ data, signal)], parameters)
    assert int(np.argmax(found.alone)) // each == 0
    assert np.unique(parameters.element[found.prior_var > 0]).tolist() == [4, 9]


def test_what_the_data_do_not_constrain_is_not_taken() -> None:
    """Columns that are the same but for rounding, with priors of which some are as wide as any that is tried."""
    rng = generator(5, "the same columns")
    one = 1e5 * rng.standard_normal((N_DATA, 3))
    columns = np.concatenate([one, one, 1e-9 * one], axis=1)
    data = columns[:, 1] * 10 + rng.standard_normal(N_DATA)
    signal, parameters = columns.T @ columns, elements(9, 1)
    found = find_evidence([Likelihood(signal, columns.T @ data, signal)], parameters)
    assert np.flatnonzero(found.prior_var).tolist() in ([1], [4])
    np.testing.assert_allclose(found.x.sum(), 10, rtol=1e-6)


@pytest.mark.parametrize("each", [1, 3])
@pytest.mark.parametrize("loud", [0, 1, 60])
def test_the_best_is_that_of_all(each: int, loud: int) -> None:
    """Also where it is not the one whose likelihood can rise most, as that would have to be larger than any is."""
    rng = generator(8, "the best of many")
    n = 3 * TRIED_AT_ONCE + 1
    parameters, information, score = elements(n, each), [], []
    for _ in range(2):
        columns = rng.standard_normal((N_DATA, n * each)) * np.repeat(rng.choice([1e-5, 0.01, 1.0], n), each)
        data = rng.standard_normal(N_DATA) + columns[:, :loud].sum(axis=1)
        information.append(columns.T @ columns)
        score.append(columns.T @ data)
    blocks = np.array(information), np.array(score)
    price = rarity(parameters, TAUS)
    gains, taus = _element_gains(blocks, _members(parameters), price)
    best, gain, tau = _best_element(blocks, _members(parameters), price)
    assert (gain, tau) == (gains[best], taus[best])
    assert gain == gains.max()
