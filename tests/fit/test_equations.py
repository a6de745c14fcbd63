"""The streamed normal equations and the posterior against dense, obviously right linear algebra."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.row_buffer import RowBuffer
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.inference.prior import CovariancePrior, DiagonalPrior, FlatPrior
from hydrabeam_mpi.random import complex_normal, generator

N, ROWS = 7, 40


def problem(is_complex, seed=1):
    rng = generator(seed, "problem", str(is_complex))
    design = complex_normal(rng, (ROWS, N))
    weights = rng.uniform(0.5, 4.0, ROWS)
    truth = complex_normal(rng, (N,)) if is_complex else rng.standard_normal(N)
    data = design @ truth + complex_normal(rng, (ROWS,)) / np.sqrt(weights)
    mean = complex_normal(rng, (N,)) if is_complex else rng.standard_normal(N)
    root = complex_normal(rng, (N, 2 * N)) if is_complex else rng.standard_normal((N, 2 * N))
    return design, weights, data, mean, root @ root.conj().T


def accumulate(design, weights, data, is_complex, capacity, about=None):
    normal = NormalEquations([Block(BEAM, N, is_complex)], about=about)
    buffer = RowBuffer(normal, BEAM, capacity)
    for part in np.array_split(np.arange(len(data)), 5):
        rows = design[part] if is_complex else np.stack([design[part].real, design[part].imag])
        buffer.add(rows, weights[part] * data[part], weights[part])
    buffer.flush()
    normal.add_data(data, weights)
    return normal


def solve_posterior(normal, prior):
    return normal.gaussian({BEAM: prior}).solve()


def real_form(design, data, weights):
    """Real unknowns: stack real and imaginary parts, each with half the noise variance."""
    stacked = np.concatenate([design.real, design.imag])
    values = np.concatenate([data.real, data.imag])
    return stacked, values, np.concatenate([2 * weights, 2 * weights])


def dense_posterior(design, weights, data, mean, covariance, is_complex):
    if not is_complex:
        design, data, weights = real_form(design, data, weights)
    inverse = np.linalg.inv(covariance)
    precision = design.conj().T @ (weights[:, None] * design) + inverse
    posterior = np.linalg.inv(precision)
    return posterior @ (design.conj().T @ (weights * data) + inverse @ mean), posterior


def dense_evidence(design, weights, data, mean, covariance, is_complex):
    """ln p(d) by the marginal distribution of the data themselves."""
    if not is_complex:
        design, data, weights = real_form(design, data, weights)
        return multivariate_normal(design @ mean, design @ covariance @ design.T + np.diag(1 / weights)).logpdf(data)
    total = design @ covariance @ design.conj().T + np.diag(1 / weights)
    residual = data - design @ mean
    return (
        -len(data) * np.log(np.pi)
        - np.linalg.slogdet(total)[1]
        - (residual.conj() @ np.linalg.solve(total, residual)).real
    )


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("capacity", [1, 17, 1000])
def test_posterior_and_evidence_match_dense_algebra(is_complex, capacity):
    design, weights, data, mean, covariance = problem(is_complex)
    normal = accumulate(design, weights, data, is_complex, capacity)
    posterior = solve_posterior(normal, CovariancePrior(mean, covariance))
    expected_mean, expected_covariance = dense_posterior(design, weights, data, mean, covariance, is_complex)
    np.testing.assert_allclose(posterior.mean, expected_mean, rtol=1e-11)
    np.testing.assert_allclose(posterior.covariance, expected_covariance, rtol=1e-10, atol=1e-14)
    evidence = dense_evidence(design, weights, data, mean, covariance, is_complex)
    assert posterior.log_evidence == pytest.approx(evidence, rel=1e-12)


@pytest.mark.parametrize("is_complex", [False, True])
def test_diagonal_prior_is_the_covariance_prior_of_its_diagonal(is_complex):
    design, weights, data, mean, covariance = problem(is_complex)
    sigma = np.sqrt(np.diag(covariance).real)
    normal = accumulate(design, weights, data, is_complex, 8)
    one = solve_posterior(normal, DiagonalPrior(mean, sigma))
    other = solve_posterior(normal, CovariancePrior(mean, np.diag(sigma**2).astype(mean.dtype)))
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-12)
    assert one.log_evidence == pytest.approx(other.log_evidence, rel=1e-12)


@pytest.mark.parametrize("is_complex", [False, True])
def test_flat_prior_is_weighted_least_squares(is_complex):
    design, weights, data, mean, _ = problem(is_complex)
    posterior = solve_posterior(accumulate(design, weights, data, is_complex, 8), FlatPrior(mean))
    if not is_complex:
        design, data, weights = real_form(design, data, weights)
    root = np.sqrt(weights)
    expected = np.linalg.lstsq(root[:, None] * design, root * data, rcond=None)[0]
    np.testing.assert_allclose(posterior.mean, expected, rtol=1e-10)
    assert posterior.log_evidence is None


@pytest.mark.parametrize("is_complex", [False, True])
def test_compressed_rows_give_the_same_sums(is_complex):
    """Data that share a row enter through sum(w) and sum(w d) alone."""
    design, weights, data, *_ = problem(is_complex)
    shared = np.repeat(design[: ROWS // 2], 2, axis=0)
    full = accumulate(shared, weights, data, is_complex, 8)
    total, weighted = weights.reshape(-1, 2).sum(axis=1), (weights * data).reshape(-1, 2).sum(axis=1)
    short = NormalEquations([Block(BEAM, N, is_complex)])
    rows = design[: ROWS // 2]
    values = rows if is_complex else np.stack([rows.real, rows.imag])
    short.add_rows({BEAM: Columns(RowSet(weighted, total), values, by_group=True)})
    short.add_data(data, weights)
    np.testing.assert_allclose(short.own(BEAM), full.own(BEAM), rtol=1e-12)
    np.testing.assert_allclose(short.projection[BEAM], full.projection[BEAM], rtol=1e-12)
    np.testing.assert_allclose(short.scalars, full.scalars, rtol=1e-12)


@pytest.mark.parametrize("is_complex", [False, True])
def test_flagged_data_do_not_count(is_complex):
    design, weights, data, *_ = problem(is_complex)
    flagged = weights.copy()
    flagged[::3] = 0
    data_with_junk = np.where(flagged > 0, data, 1e30)
    kept = flagged > 0
    full = accumulate(design[kept], weights[kept], data[kept], is_complex, 8)
    with_flags = accumulate(design, flagged, data_with_junk, is_complex, 8)
    np.testing.assert_allclose(with_flags.own(BEAM), full.own(BEAM), rtol=1e-12)
    np.testing.assert_allclose(with_flags.projection[BEAM], full.projection[BEAM], rtol=1e-12)
    assert with_flags.n_data == kept.sum()


@pytest.mark.parametrize("is_complex", [False, True])
def test_draws_have_the_posterior_mean_and_covariance(is_complex):
    design, weights, data, mean, covariance = problem(is_complex)
    posterior = solve_posterior(accumulate(design, weights, data, is_complex, 8), CovariancePrior(mean, covariance))
    draws = np.array([posterior.draw(generator(5, "draw", i)) for i in range(4000)])
    z = (draws.mean(axis=0) - posterior.mean) / posterior.std * np.sqrt(4000)
    assert np.abs(z).max() < 5
    centred = (draws - posterior.mean) / posterior.std
    expected = posterior.covariance / np.outer(posterior.std, posterior.std)
    np.testing.assert_allclose(centred.T @ centred.conj() / 4000, expected, atol=5 / np.sqrt(4000))


@pytest.mark.parametrize("is_complex", [False, True])
def test_predictive_variance(is_complex):
    design, weights, data, mean, covariance = problem(is_complex)
    posterior = solve_posterior(accumulate(design, weights, data, is_complex, 8), CovariancePrior(mean, covariance))
    rows = design[:5] if is_complex else design[:5].real
    expected = np.diag(rows @ posterior.covariance @ rows.conj().T).real
    np.testing.assert_allclose(posterior.predictive_variance(rows), expected, rtol=1e-12)


def test_more_coefficients_than_data_with_a_flat_prior_is_refused():
    design, weights, data, mean, _ = problem(True)
    few = slice(0, N - 1)
    with pytest.raises(InputError, match="7 coefficients cannot be inferred from 6 visibilities"):
        solve_posterior(accumulate(design[few], weights[few], data[few], True, 8), FlatPrior(mean))


def test_degenerate_columns_with_a_flat_prior_are_refused():
    design, weights, data, mean, _ = problem(False)
    design[:, 1] = 0
    with pytest.raises(InputError, match="leave some beam modes free"):
        solve_posterior(accumulate(design, weights, data, False, 8), FlatPrior(mean))


def test_prior_covariance_must_be_positive_definite():
    with pytest.raises(InputError, match="not positive definite"):
        CovariancePrior(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]))


@pytest.mark.parametrize("is_complex", [True, False])
def test_sums_with_louder_noise_are_those_of_smaller_weights(is_complex):
    design, weights, data, mean, covariance = problem(is_complex)
    prior, scale = CovariancePrior(mean, covariance), 2.5
    scaled = accumulate(design, weights, data, is_complex, 7).with_noise(scale)
    anew = accumulate(design, weights / scale, data, is_complex, 7)
    one, two = solve_posterior(scaled, prior), solve_posterior(anew, prior)
    np.testing.assert_allclose(one.mean, two.mean, rtol=1e-10)
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-10)
    assert one.log_evidence == pytest.approx(two.log_evidence, rel=1e-12)
    x = prior.mean
    direct = float(np.sum(weights / scale * np.abs(data - design @ x) ** 2))
    assert scaled.misfit("beam", x) == pytest.approx(direct, rel=1e-10)


@pytest.mark.parametrize("is_complex", [True, False])
def test_unknowns_may_be_counted_from_anywhere(is_complex):
    design, weights, data, mean, covariance = problem(is_complex)
    start, prior = 3 * mean + 1, CovariancePrior(mean, covariance)
    plain = accumulate(design, weights, data, is_complex, 7)
    shifted = accumulate(design, weights, data - design @ start, is_complex, 7, {BEAM: start})
    for one, two in ((plain, shifted), (plain.with_noise(2.5), shifted.with_noise(2.5))):
        expected, found = solve_posterior(one, prior), solve_posterior(two, prior)
        np.testing.assert_allclose(found.mean + start, expected.mean, rtol=1e-9)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-10)
        assert found.log_evidence == pytest.approx(expected.log_evidence, rel=1e-12)
        assert two.misfit(BEAM, mean) == pytest.approx(one.misfit(BEAM, mean), rel=1e-10)


def test_generators_depend_on_the_key_alone():
    assert generator(1, "a", 2).standard_normal() == generator(1, "a", 2).standard_normal()
    values = {generator(seed, *key).standard_normal() for seed in (1, 2) for key in (("a",), ("a", 1), ("b", 1))}
    assert len(values) == 6
