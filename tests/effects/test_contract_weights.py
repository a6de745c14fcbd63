"""What every change of the weights must satisfy: none comes into the catalogue without it."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.registry import REWEIGHTINGS, make_reweighting
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.cases import experiment_of
from tests.effects.small import part_of, small_block


def noisy(seed: int = 0) -> RowBlock:
    """Rows of noise as large as their weights say, some without weight."""
    block = small_block(experiment_of((131e6, 151e6), 40, 60))
    rng = generator(seed, "noise")
    sigma = 0.01 * np.abs(block.vis).max()
    residual = sigma * complex_normal(rng, block.shape)
    return replace(block, residual=residual, weights=np.where(rng.random(block.shape) < 0.1, 0.0, sigma**-2))


@pytest.mark.parametrize("kind", REWEIGHTINGS)
def test_neutral_weights_change_nothing(kind: str) -> None:
    change, block = make_reweighting(kind, {}), noisy()
    neutral = change.neutral(block.setup)
    assert max(change.sizes(block.setup)) == len(neutral)
    assert pickle.loads(pickle.dumps(change)).neutral(block.setup) == neutral
    for size in change.sizes(block.setup):
        x = np.array(list(neutral.values())[:size])
        np.testing.assert_array_equal(change.weight_factor(block, x), np.ones(block.shape))
        injected = change.inject(block.residual, block, x, generator(1, "neutral"))
        np.testing.assert_array_equal(injected, block.residual)


@pytest.mark.parametrize("kind", REWEIGHTINGS)
def test_it_knows_which_of_its_parameters_are_of_antennas(kind: str) -> None:
    change, setup = make_reweighting(kind, {}), noisy().setup
    neutral = change.neutral(setup)
    for size in change.sizes(setup):
        of_antennas = any(name.startswith("antenna ") for name in list(neutral)[:size])
        assert change.scales_antennas(np.tile(list(neutral.values())[:size], (2, 1))) == of_antennas


@pytest.mark.parametrize("kind", REWEIGHTINGS)
def test_reweightings_are_drawn_and_put_into_data_by_a_seed(kind: str) -> None:
    change, block = make_reweighting(kind, {}), noisy()
    x, again, nothing = (change.draw(block.setup, generator(1, kind), size) for size in (0.3, 0.3, 0.0))
    np.testing.assert_array_equal(x, again)
    assert len(x) in change.sizes(block.setup)
    one, two = (change.inject(block.residual, block, x, generator(2, kind)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    changed = one != block.residual
    assert changed.any()
    assert not changed[block.weights == 0].any()
    np.testing.assert_array_equal(change.inject(block.residual, block, nothing, generator(2, kind)), block.residual)
    factor = change.weight_factor(block, x)
    assert factor.shape == block.shape
    assert np.all((factor >= 0) & np.isfinite(factor))


@pytest.mark.parametrize("kind", REWEIGHTINGS)
def test_sums_of_some_rows_add_up(kind: str) -> None:
    """Of whole groups of redundant baselines, as ranks have them."""
    change, block = make_reweighting(kind, {}), noisy()
    whole = change.sums(block, block.residual * np.sqrt(block.weights))
    assert whole.shape == (change.n_sums(block.setup),)
    times, few = np.arange(len(block.times)), block.member < 4
    total = np.zeros_like(whole)
    for some in (part_of(block, t, b) for t in np.split(times, [13]) for b in map(np.flatnonzero, (few, ~few))):
        total += change.sums(some, some.residual * np.sqrt(some.weights))
    np.testing.assert_allclose(total, whole, rtol=1e-10, atol=1e-8)


@pytest.mark.parametrize("taken", ["in all", "of each baseline"])
@pytest.mark.parametrize("kind", REWEIGHTINGS)
def test_noise_as_large_as_it_should_be_needs_no_other_weights(kind: str, taken: str) -> None:
    change, block = make_reweighting(kind, {}), noisy()
    setup = block.setup
    rows = change.sums(block, block.residual * np.sqrt(block.weights))
    sums = np.array([rows, np.zeros_like(rows)])  # a channel without data beside the other
    n_freqs, n_bls = setup.observation.Nfreqs, setup.observation.Nbls
    found = change.fit(setup, sums, np.zeros(n_freqs if taken == "in all" else (n_freqs, n_bls)))
    assert found.log_bayes_factor < 4
    assert found.reason is None
    assert found.x.shape == found.std.shape == (n_freqs, len(found.names))
    assert len(found.names) == len(found.units) in change.sizes(setup)
    assert found.names == tuple(change.neutral(setup))[: len(found.names)]
    assert np.all(np.isfinite(found.x) & (found.std >= 0))
