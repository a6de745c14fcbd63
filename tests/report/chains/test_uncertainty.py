"""What the beam owes to all else: marginal against conditional spread, and the directions of both together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.report.chains.degeneracy import directions_of
from hydrabeam_mpi.report.chains.pooled import Pooled, pool
from hydrabeam_mpi.report.chains.uncertainty import on_sky, spread_of
from hydrabeam_mpi.sampling.storage.store import ChainStore
from tests.report.chains.made import N_MODES, SHARE, new_chains
from tests.sampling.made import add, new_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> ChainStore:
    return new_chains(tmp_path_factory.mktemp("chains"))


@pytest.fixture(scope="module")
def pooled(store: ChainStore) -> Pooled:
    found = pool(store)
    assert found is not None
    return found


def test_draws_are_pooled_at_even_intervals(store: ChainStore, pooled: Pooled) -> None:
    assert (pooled.n_draws, pooled.freq) == (600, 1.2e8)
    np.testing.assert_array_equal(pooled.beam[150:300], store.read("beam", 1)[::2, 0])
    expected = ["flux[Fornax A]", "flux[B]", "flux[C]"]
    assert pooled.labels == [*expected, "noise[freq=120000000]"]
    other = pool(store, 1)
    assert other is not None
    assert (other.freq, other.labels) == (1.3e8, [*expected, "noise[freq=130000000]"])
    np.testing.assert_array_equal(other.beam[:150], store.read("beam", 0)[::2, 1])


def test_the_marginal_spread_is_wider_by_what_the_beam_owes_to_the_flux(pooled: Pooled) -> None:
    spread = spread_of(pooled)
    assert spread is not None
    functions = on_sky(pooled, np.eye(N_MODES))
    alone = np.sum(functions**2, axis=0)
    marginal = 1e-3 * np.sqrt(alone + SHARE**2 * functions[0] ** 2)
    seen = marginal > 1e-3 * marginal.max()
    np.testing.assert_allclose(spread.marginal[seen], marginal[seen], rtol=0.15)
    np.testing.assert_allclose(spread.conditional[seen], 1e-3 * np.sqrt(alone[seen]), rtol=0.15)
    assert np.nanmax(spread.ratio) > 1.2


def test_the_direction_is_that_of_the_flux(pooled: Pooled) -> None:
    (first, *further), chance = directions_of(pooled)
    assert further == []
    # Of a beam = SHARE x flux + its own, the correlation is SHARE / sqrt(SHARE^2 + 1).
    assert first.strength == pytest.approx(SHARE / np.hypot(SHARE, 1), abs=0.05)
    assert chance < 0.5 < first.strength
    assert first.correlations[0] > 0.95
    assert np.abs(first.correlations[1:]).max() < 0.3
    expected = 1e-3 * SHARE * on_sky(pooled, np.eye(N_MODES)[:1])[0]
    assert np.abs(first.response - expected).max() < 0.2 * np.abs(expected).max()


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_chance_is_seldom_taken_for_a_direction(rho: float, pooled: Pooled) -> None:
    """In one case of twenty, also where draws depend on those before them."""
    taken = 0
    for seed in range(20):
        white = np.random.default_rng(seed).normal(size=(4, 150, 16))
        for t in range(1, 150):
            white[:, t] = rho * white[:, t - 1] + np.sqrt(1 - rho**2) * white[:, t]
        beam, others = np.split(white.reshape(600, 16), [N_MODES], axis=1)
        taken += bool(directions_of(replace(pooled, beam=beam, others=others, labels=list("abcd")))[0])
    assert taken <= 3


def test_more_parameters_than_draws_tell_nothing(pooled: Pooled) -> None:
    many = np.random.default_rng(2).normal(size=(pooled.n_draws, 700))
    crowded = replace(pooled, others=many, labels=[str(number) for number in range(700)])
    assert directions_of(crowded)[0] == []
    assert spread_of(crowded) is None


def test_without_draws_there_is_nothing_to_show(tmp_path: Path) -> None:
    store = new_store(tmp_path)
    assert pool(store) is None
    with store.writer(0) as writer:
        add(writer, 0, 1)
    assert pool(store) is None
