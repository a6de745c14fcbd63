"""Beams that hang together over frequency, against the joint Gaussian of all coefficients written out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import kstest, multivariate_normal

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.inference.coupled import ChannelTold, CoupledEquations, CoupledPosterior
from hydrabeam_mpi.inference.over_frequency import legendre, modes_of, squared_exponential
from hydrabeam_mpi.random import complex_normal, generator

FREQS: FloatArray = np.array([120.0, 121.0, 121.5, 124.0, 128.0]) * 1e6
N, N_DATA = 3, 7
SIGMA = 0.3


def normal(rng: np.random.Generator, shape: tuple[int, ...], is_complex: bool) -> Array:
    return complex_normal(rng, shape) if is_complex else rng.standard_normal(shape)


def designs(is_complex: bool, scale: float = 1.0) -> list[Array]:
    rng = generator(1, "designs")
    return [scale * normal(rng, (N_DATA, N), is_complex) for _ in FREQS]


def told_of(design: Array, data: Array) -> ChannelTold:
    """Return what data with noise of variance SIGMA^2 say: real data of real numbers, circular ones of complex."""
    kappa, n = (1.0, np.pi * SIGMA**2) if np.iscomplexobj(design) else (2.0, 2 * np.pi * SIGMA**2)
    level = -(np.vdot(data, data).real / SIGMA**2 + N_DATA * np.log(n) * (kappa if kappa == 1 else 1)) / kappa
    return ChannelTold(design.conj().T @ design / SIGMA**2, design.conj().T @ data / SIGMA**2, float(level))


def solve(modes: FloatArray, told: list[ChannelTold], n_draws: int = 0, seed: int = 0) -> CoupledPosterior:
    equations = CoupledEquations(modes, N, bool(np.iscomplexobj(told[0].score)), n_draws)
    keys = [[("draw", channel, draw) for draw in range(n_draws)] for channel in range(len(told))]
    for channel, one in enumerate(told):
        equations.add(channel, one, one.noise(keys[channel], seed, len(told)))
    return equations.solve()


@pytest.mark.parametrize("is_complex", [False, True])
def test_is_the_joint_posterior_of_all_channels(is_complex: bool) -> None:
    covariance = squared_exponential(FREQS, 2e6)
    rng, parts = generator(2, "data"), designs(is_complex)
    data = [normal(rng, (N_DATA,), is_complex) for _ in FREQS]
    solved = solve(modes_of(covariance), [told_of(*one) for one in zip(parts, data, strict=True)])

    design, prior = block_diag(*parts), np.kron(covariance, np.eye(N))
    of_data = design @ prior @ design.conj().T + SIGMA**2 * np.eye(len(design))
    gain = prior @ design.conj().T @ np.linalg.inv(of_data)
    mean, spread = gain @ np.concatenate(data), prior - gain @ design @ prior
    for f, one in enumerate(solved.moments(0, [])):
        own = slice(N * f, N * f + N)
        std = np.sqrt(np.diag(spread[own, own]).real)
        assert np.max(np.abs(one.mean - mean[own]) / std) < 1e-10
        np.testing.assert_allclose(one.covariance, spread[own, own], atol=1e-11)
    whole = np.concatenate(data)
    if is_complex:
        quadratic = np.vdot(whole, np.linalg.solve(of_data, whole)).real
        expected = -quadratic - np.linalg.slogdet(of_data)[1] - len(whole) * np.log(np.pi)
    else:
        expected = multivariate_normal(cov=of_data).logpdf(whole)
    assert solved.joint.log_evidence == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("is_complex", [False, True])
def test_channels_that_know_nothing_of_each_other_are_independent(is_complex: bool) -> None:
    rng, parts = generator(3, "data"), designs(is_complex)
    told = [told_of(one, normal(rng, (N_DATA,), is_complex)) for one in parts]
    together = solve(modes_of(squared_exponential(FREQS, 1.0)), told)
    evidence = 0.0
    for one, joint in zip(told, together.moments(0, []), strict=True):
        precision = np.eye(N) + one.information
        std = np.sqrt(np.diag(np.linalg.inv(precision)).real)
        assert np.max(np.abs(joint.mean - np.linalg.solve(precision, one.score)) / std) < 1e-12
        np.testing.assert_allclose(joint.covariance, np.linalg.inv(precision), atol=1e-12 * std.min() ** 2)
        evidence += solve(np.ones((1, 1)), [one]).joint.log_evidence or 0.0
    assert together.joint.log_evidence == pytest.approx(evidence, rel=1e-13)


@pytest.mark.parametrize("modes", [modes_of(squared_exponential(FREQS, 4e6)), legendre(FREQS, 2)])
def test_draws_have_the_joint_posterior(modes: FloatArray) -> None:
    rng = generator(4, "data")
    told = [told_of(one, rng.standard_normal(N_DATA)) for one in designs(False, 0.2)]
    n_draws = 4000
    solved = solve(modes, told, n_draws)
    draws = solved.draws(0, range(n_draws))
    means = np.array([one.mean for one in solved.moments(0, [])])
    away = (draws - means).reshape(n_draws, -1)
    spread = np.cov(away.T, bias=True)
    whole = np.einsum(
        "fm,minj,gn->figj", modes, solved.joint.covariance.reshape(modes.shape[1], N, modes.shape[1], N), modes
    ).reshape(spread.shape)
    std = np.sqrt(np.diag(whole))
    # Each entry by its own sampling error: a right program fails for one seed in ten thousand.
    error = np.sqrt((np.outer(std, std) ** 2 + whole**2) / n_draws)
    assert np.max(np.abs(spread - whole) / error) < 5
    assert np.max(np.abs(away.mean(axis=0)) / std) < 5 / np.sqrt(n_draws)


def test_truths_drawn_from_the_prior_are_covered() -> None:
    """Simulation-based calibration, which a noise that is stated wrong by a factor of two does not pass."""
    modes, parts = modes_of(squared_exponential(FREQS, 3e6)), designs(False)

    def distances(stated: float) -> Array:
        found = []
        for number in range(200):
            rng = generator(5, "mock", number)
            truth = modes @ rng.standard_normal((modes.shape[1], N))
            data = [one @ a + SIGMA * rng.standard_normal(N_DATA) for one, a in zip(parts, truth, strict=True)]
            told = [told_of(*one) for one in zip(parts, data, strict=True)]
            told = [ChannelTold(one.information / stated, one.score / stated) for one in told]
            joint = solve(modes, told).joint
            # In a direction that all channels share, of which one number a mock is taken.
            mean = modes @ joint.mean.reshape(-1, N)
            weights = np.kron(modes.sum(axis=0), [1.0, 0.0, 0.0])
            found.append((truth - mean)[:, 0].sum() / np.sqrt(weights @ joint.covariance @ weights))
        return np.array(found)

    assert kstest(distances(1.0), "norm").pvalue > 1e-3
    assert kstest(distances(0.25), "norm").pvalue < 1e-3
