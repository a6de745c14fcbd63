"""The Newton step of all effects is the dense solution of one system of all channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.joint_step import HELD, solve_jointly
from hydrabeam_mpi.fit.state import Active, Values, independent_prior
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.prior import ChannelPrior, CovariancePrior, DiagonalPrior, FlatPrior, Prior, precision_of
from hydrabeam_mpi.random import generator


def active(effect: Effect, n: int, unused: int = 0, held: FloatArray | None = None, limit: float = np.inf) -> Active:
    """An effect with parameters of very different natural sizes, the last ``unused`` of which are held at zero."""
    used, prior = independent_prior(np.append(np.geomspace(1e-4, 1e4, n), np.zeros(unused)), effect.shared)
    zeros = np.zeros((1, n + unused))
    combinations = np.zeros((0, n + unused)) if held is None else np.pad(held, ((0, 0), (0, unused)))
    return Active(effect, used, prior, zeros, np.full(n + unused, limit), combinations)


def with_priors(one: Active, *priors: Prior) -> Active:
    return replace(one, prior=ChannelPrior(priors, one.effect.shared))


def normal(n: int, seed: int) -> DiagonalPrior:
    """About values that are not zero, and of other widths for another seed."""
    rng = generator(seed, "diagonal")
    sigma = np.geomspace(1e-2, 1e2, n) * rng.uniform(0.2, 5, n)
    return DiagonalPrior(sigma * rng.standard_normal(n), sigma)


def correlated(n: int, seed: int, n_freqs: int = 1) -> CovariancePrior:
    """Of some channels together."""
    rng, sigma = generator(seed, "correlated"), np.tile(normal(n, seed).sigma, n_freqs)
    root = rng.standard_normal((len(sigma), 2 * len(sigma)))
    root *= (sigma / np.linalg.norm(root, axis=1))[:, np.newaxis]
    return CovariancePrior(sigma * rng.standard_normal(len(sigma)), root @ root.T)


def coupled(one: Active, n_freqs: int, seed: int) -> Active:
    """Give an effect a prior of all of its parameters in all channels together."""
    return replace(one, prior=ChannelPrior((correlated(len(one.used), seed, n_freqs),), n_coupled=n_freqs))


def units(values: Values) -> FloatArray:
    """Return the widths of the prior in the first channel, one where it is flat."""
    std = values.prior_std(0)
    return np.where(np.isfinite(std), std, 1.0)


def placed(values: Values, x: FloatArray) -> Values:
    """Put the parameters in use, (Nfreqs, q), in their places in all channels."""
    wider = [replace(one, x=np.zeros((len(x), one.x.shape[1]))) for one in values.active]
    return replace(values, active=tuple(wider)).at(x)


COMMON = np.array([[1.0, 1.0, 1.0, 1.0]]) / 2
TWO_COMMON = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]]) / np.sqrt(2)
CASES: dict[str, tuple[int, list[Active]]] = {
    "one channel, its own parameters": (1, [active(AntennaGains(), 4)]),
    "three channels, their own parameters": (3, [active(AntennaGains(), 4, unused=2)]),
    "three channels, shared parameters": (3, [active(AntennaDelays(), 5)]),
    "three channels, shared beside their own": (3, [active(AntennaGains(), 4), active(AntennaDelays(), 3, unused=1)]),
    "two shared with others between": (
        2,
        [active(AntennaDelays(), 2), active(CrossCoupling(), 3), active(AntennaPositions(), 3)],
    ),
    "what is undecidable is held, of own parameters": (2, [active(AntennaGains(), 4, held=TWO_COMMON)]),
    "what is undecidable is held, of shared parameters": (3, [active(AntennaDelays(), 4, unused=1, held=COMMON)]),
    "what is undecidable is held, of either": (
        3,
        [active(AntennaDelays(), 4, held=COMMON), active(AntennaGains(), 4, held=TWO_COMMON)],
    ),
    "another prior in each channel": (3, [with_priors(active(AntennaGains(), 4), *(normal(4, f) for f in range(3)))]),
    "correlated, and another in each channel, beside shared ones": (
        3,
        [
            with_priors(active(AntennaDelays(), 3), correlated(3, 7)),
            with_priors(active(AntennaGains(), 4, unused=1), *(correlated(4, f) for f in range(3))),
        ],
    ),
    "correlated, and something is held": (
        2,
        [
            with_priors(active(AntennaDelays(), 4, held=COMMON), correlated(4, 7)),
            with_priors(active(AntennaGains(), 4, held=TWO_COMMON), correlated(4, 1), normal(4, 2)),
        ],
    ),
    "coupled": (3, [coupled(active(AntennaGains(), 4, unused=1), 3, 5)]),
    "coupled beside shared and own ones, and something is held": (
        2,
        [
            active(AntennaDelays(), 4, held=COMMON),
            coupled(active(AntennaGains(), 4, held=TWO_COMMON), 2, 5),
            active(CrossCoupling(), 3),
        ],
    ),
    "flat": (2, [with_priors(active(AntennaGains(), 3), FlatPrior(np.zeros(3))), active(AntennaDelays(), 3)]),
}


def likelihoods(n_freqs: int, width: FloatArray) -> list[Likelihood]:
    """Random information, some of it far weaker and some far stronger than the prior, and a score."""
    made = []
    for f in range(n_freqs):
        rng = generator(f, "newton")
        root = rng.standard_normal((len(width), 2 * len(width))) * np.geomspace(0.03, 30, len(width))[:, np.newaxis]
        root = rng.permutation(root) / width[:, np.newaxis]
        score = root @ rng.standard_normal(2 * len(width))
        made.append(Likelihood(root @ root.T, score, root @ root.T))
    return made


def held_combinations(values: Values) -> FloatArray:
    """All of them, over the parameters in use side by side."""
    rows = [np.zeros((0, len(values.shared)))]
    for one, span in zip(values.active, values.spans, strict=True):
        part = np.zeros((len(one.degenerate_directions), len(values.shared)))
        part[:, span] = one.degenerate_directions[:, one.used]
        rows.append(part)
    return np.concatenate(rows)


def dense(values: Values, found: list[Likelihood]) -> tuple[FloatArray, list[FloatArray]]:
    """Maximise the posterior of the parameters of all channels at once, with held combinations exactly zero.

    Returns new parameters, (Nfreqs, q), and each channel's covariance.
    """
    x, n_freqs = values.x, len(values.x)
    n_own = [len(one.used) * (1 if one.prior.shared else n_freqs) for one in values.active]
    # To each channel's parameters from all unknowns: effect after effect, and of each channel after channel.
    maps = np.zeros((n_freqs, x.shape[1], sum(n_own)))
    precision, mean, here, start = np.zeros((sum(n_own), sum(n_own))), np.zeros(sum(n_own)), np.zeros(sum(n_own)), 0
    for one, span, size in zip(values.active, values.spans, n_own, strict=True):
        n, whole = len(one.used), slice(start, start + size)
        for f in range(n_freqs):
            first = start if one.prior.shared else start + f * n
            maps[f, span, first : first + n] = np.eye(n)
            here[first : first + n] = x[f, span]
        priors = one.prior.priors if size == n or one.prior.n_coupled else [one.prior.of(f) for f in range(n_freqs)]
        precision[whole, whole] = block_diag(*map(precision_of, priors))
        mean[whole] = np.concatenate([prior.mean for prior in priors])
        start += size
    matrix, score = precision.copy(), precision @ mean
    for one, likelihood in zip(maps, found, strict=True):
        matrix += one.T @ likelihood.information @ one
        score += one.T @ (likelihood.score + likelihood.information @ (one @ here))
    held = np.concatenate([held_combinations(values) @ one for one in maps])
    # In units of the prior, in which directions are told apart; those that are free.
    own = np.diag(precision)
    width = 1 / np.sqrt(np.where(own > 0, own, 1.0))
    _, values, right = np.linalg.svd(held * width)
    free = width[:, np.newaxis] * right[int(np.sum(values > 1e-9)) :].T
    covariance = free @ np.linalg.solve(free.T @ matrix @ free, free.T)
    best = covariance @ score
    return np.array([one @ best for one in maps]), [one @ covariance @ one.T for one in maps]


def log_joint(values: Values, found: list[Likelihood], start: FloatArray, x: FloatArray) -> float:
    """Return ln(likelihood x prior) at ``x`` of the model that is linearised at ``start``, (Nfreqs, q) each."""
    steps = zip(found, x - start, strict=True)
    likelihood = sum(float(one.score @ step - 0.5 * step @ one.information @ step) for one, step in steps)
    return likelihood + sum(one.prior.log_density(one.x[:, one.used]) for one in placed(values, x).active)


@pytest.mark.parametrize(("n_freqs", "effects"), CASES.values(), ids=CASES)
def test_the_step_is_that_of_one_system_of_all_channels(n_freqs: int, effects: list[Active]) -> None:
    values = Values(tuple(effects))
    width, shared = units(values), values.shared
    x = width * generator(9, "start").standard_normal((n_freqs, len(width)))
    x[:, shared] = x[0, shared]
    values = placed(values, x)
    found = likelihoods(n_freqs, width)
    new, std, covariances, moved, gain = solve_jointly(values, found)
    expected, dense_covariances = dense(values, found)
    # What is held gives way by as much as information is to the precision that holds it.
    largest = max(float(np.linalg.norm(width[:, np.newaxis] * one.information * width)) for one in found)
    yields = largest / HELD if len(held_combinations(values)) else 1e-10
    np.testing.assert_allclose(new / width, expected / width, rtol=0, atol=10 * yields)
    for one, other in zip(covariances, dense_covariances, strict=True):
        np.testing.assert_allclose(one / np.outer(width, width), other / np.outer(width, width), rtol=0, atol=yields)
    np.testing.assert_allclose(std, np.sqrt([np.diag(one) for one in covariances]), rtol=1e-12)
    assert moved == pytest.approx(np.max(np.abs(new - x) / std), rel=1e-12)
    if not len(held_combinations(values)):
        assert gain == pytest.approx(log_joint(values, found, x, new) - log_joint(values, found, x, x), rel=1e-9)
    assert np.ptp(new[:, shared], axis=0).max(initial=0) == 0
    held = held_combinations(values) * width
    across = (new / width) @ held.T / np.linalg.norm(held, axis=1)
    np.testing.assert_allclose(across, 0, atol=10 * yields)


def test_at_the_maximum_nothing_moves() -> None:
    n_freqs, effects = CASES["three channels, shared beside their own"]
    values = Values(tuple(effects))
    found = likelihoods(n_freqs, units(values))
    best, *_ = solve_jointly(placed(values, np.zeros((n_freqs, len(values.shared)))), found)
    there = [
        Likelihood(one.information, one.score - one.information @ x, one.signal)
        for one, x in zip(found, best, strict=True)
    ]
    again, _, _, moved, gain = solve_jointly(placed(values, best), there)
    np.testing.assert_allclose(again, best, rtol=1e-9)
    assert moved < 1e-9
    assert abs(gain) < 1e-9


@pytest.mark.parametrize("limit", [1e-3, 0.5, np.inf])
def test_steps_of_few_parameters_are_limited(limit: float) -> None:
    """Those that have a natural size beyond which they are no longer linear; the others go their way."""
    free, held_back = active(AntennaGains(), 3), active(AntennaPositions(), 3, limit=limit)
    x = np.zeros((2, 6))
    both = (Values((free, one)) for one in (held_back, active(AntennaPositions(), 3)))
    values, unlimited = (placed(one, x) for one in both)
    found = likelihoods(2, units(values))
    new, std, _, moved, _ = solve_jointly(values, found)
    full, full_std, *_ = solve_jointly(unlimited, found)
    np.testing.assert_array_equal(new[:, :3], full[:, :3])
    np.testing.assert_array_equal(new[:, 3:], np.clip(full[:, 3:], -limit, limit))
    np.testing.assert_array_equal(std, full_std)
    assert moved == pytest.approx(np.max(np.abs(new) / std))


def test_nothing_in_use_moves_nothing() -> None:
    empty = Likelihood(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))
    values = placed(Values((active(AntennaGains(), 0, unused=3),)), np.zeros((2, 0)))
    new, std, covariances, moved, _ = solve_jointly(values, [empty, empty])
    assert new.shape == std.shape == (2, 0)
    assert [one.shape for one in covariances] == [(0, 0)] * 2
    assert moved == 0
