"""Residuals whitened by their predictive distribution, against roots and determinants of whole covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.fit.whitening import TimeWhitener, model_root, root_of
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.random import complex_normal, generator

MEMBER = np.array([0, 0, 0, 1, 2, 2, 3, 1])


def parts(rows: ComplexArray) -> FloatArray:
    """Real parts before imaginary ones, along the first axis."""
    return np.concatenate([rows.real, rows.imag])


def symmetric_root(covariance: FloatArray) -> FloatArray:
    """The inverse of the symmetric root of 1 + a covariance."""
    values, vectors = np.linalg.eigh(np.eye(len(covariance)) + covariance)
    return (vectors / np.sqrt(values)) @ vectors.T


@dataclass(frozen=True)
class Time:
    """The rows of one time: weights, the design of their groups as the package has it and as plain complex rows."""

    weights: FloatArray
    design: np.ndarray
    rows: ComplexArray
    posterior: Posterior

    @property
    def root(self) -> FloatArray:
        """Of the covariance of the groups' predictions, as the package has it."""
        return model_root(self.posterior, self.design)

    def covariance(self) -> FloatArray:
        """Of the predictions' parts over the noise, by the parts of the coefficients."""
        root = np.tile(np.sqrt(2 * self.weights), 2)
        rows = self.rows[MEMBER]
        inverse = np.linalg.inv(self.posterior.factor @ self.posterior.factor.conj().T)
        if self.posterior.is_complex:
            jacobian = np.block([[rows.real, -rows.imag], [rows.imag, rows.real]])
            inverse = 0.5 * np.block([[inverse.real, -inverse.imag], [inverse.imag, inverse.real]])
        else:
            jacobian = parts(rows)
        return root[:, np.newaxis] * (jacobian @ inverse @ jacobian.T) * root


def time_of(is_complex: bool, n_modes: int, flagged: IntArray, strength: float) -> Time:
    rng = generator(1, "predictive", int(is_complex), n_modes)
    rows = complex_normal(rng, (4, n_modes))
    design = rows if is_complex else np.stack([rows.real, rows.imag])
    factor = np.tril(complex_normal(rng, (n_modes, n_modes)) if is_complex else rng.standard_normal((n_modes,) * 2))
    factor[np.diag_indices(n_modes)] = rng.uniform(1, 2, n_modes)
    weights = rng.uniform(0.5, 2.0, len(MEMBER))
    weights[flagged] = 0.0
    mean = np.zeros(n_modes, dtype=factor.dtype)
    return Time(weights, design, rows, Posterior(mean, factor / strength))


FLAGGED = {
    "no row flagged": np.zeros(0, dtype=int),
    "some rows flagged": np.array([1, 4]),
    "whole groups flagged": np.array([0, 4, 5, 6]),
    "one row left": np.arange(1, 8),
}


@pytest.mark.parametrize(
    "strength", [1e-6, 1.0, 100.0], ids=["a known beam", "as uncertain as noise", "an unknown beam"]
)
@pytest.mark.parametrize("n_modes", [2, 12], ids=["fewer modes than rows", "more modes than rows"])
@pytest.mark.parametrize("flagged", FLAGGED.values(), ids=FLAGGED)
@pytest.mark.parametrize("is_complex", [False, True], ids=["real coefficients", "complex coefficients"])
def test_a_time_is_whitened_by_the_symmetric_root(
    is_complex: bool, flagged: IntArray, n_modes: int, strength: float
) -> None:
    time = time_of(is_complex, n_modes, flagged, strength)
    residuals = complex_normal(generator(2, "residuals"), (len(MEMBER), 3))
    whitener = TimeWhitener.of(time.weights, MEMBER, time.root)
    z, share, variance = whitener.rows(residuals), whitener.share, whitener.variance
    covariance = time.covariance()
    expected = symmetric_root(covariance) @ (np.tile(np.sqrt(2 * time.weights), 2)[:, np.newaxis] * parts(residuals))
    np.testing.assert_allclose(parts(z), expected, rtol=0, atol=1e-7)
    shares = np.diag(np.linalg.solve(np.eye(16) + covariance, covariance))
    np.testing.assert_allclose(share, shares.reshape(2, -1).mean(axis=0), rtol=0, atol=1e-6)
    assert not z[flagged].any()
    by_row = 2 * np.concatenate([time.weights] * 2) * np.tile(variance / 2, 2)
    assert by_row.sum() == pytest.approx(np.trace(covariance), rel=1e-6)


def test_a_time_that_is_wholly_flagged_says_nothing() -> None:
    time = time_of(False, 3, np.arange(8), 1.0)
    ones = np.ones((8, 2), complex)
    whitener = TimeWhitener.of(time.weights, MEMBER, time.root)
    assert not whitener.rows(ones).any()
    assert not whitener.share.any()
    assert not whitener.variance.any()


@pytest.mark.parametrize("flagged", FLAGGED.values(), ids=FLAGGED)
def test_what_groups_have_alike_is_whitened_as_rows_of_baselines_are(flagged: IntArray) -> None:
    time = time_of(False, 12, flagged, 1.0)
    whitener = TimeWhitener.of(time.weights, MEMBER, time.root)
    alike = complex_normal(generator(5, "alike"), (4, 3))
    as_rows = whitener.gather.T @ whitener.of_groups(alike)
    np.testing.assert_allclose(as_rows, whitener.rows(alike[MEMBER]), rtol=0, atol=1e-12)


@pytest.mark.parametrize("is_complex", [False, True], ids=["real coefficients", "complex coefficients"])
def test_draws_from_the_predictive_distribution_become_white(is_complex: bool) -> None:
    """Noise of the data's own and errors as the posterior draws them."""
    time = time_of(is_complex, 5, FLAGGED["some rows flagged"], 1.0)
    rng = generator(3, "draws")
    errors = np.array([time.posterior.draw(rng) for _ in range(20000)]).T
    used = time.weights > 0
    sigma = np.where(used, 1 / np.sqrt(np.where(used, time.weights, 1.0)), 0.0)
    rows = time.rows[MEMBER] @ errors + sigma[:, np.newaxis] * complex_normal(rng, (8, 20000))
    white = parts(TimeWhitener.of(time.weights, MEMBER, time.root).rows(rows)[used])
    # The errors of 20000 draws: 0.007 of covariances, 0.01 of variances.
    np.testing.assert_allclose(white @ white.T / 20000, np.eye(len(white)), rtol=0, atol=0.05)


@pytest.mark.parametrize("is_complex", [False, True], ids=["real coefficients", "complex coefficients"])
@pytest.mark.parametrize("n_modes", [2, 12], ids=["fewer modes than rows", "more modes than rows"])
def test_a_fitted_time_is_whitened_as_the_others_predict_it(n_modes: int, is_complex: bool) -> None:
    """The same as by a fit to the other times alone."""
    rng = generator(4, "others", int(is_complex), n_modes)
    times = [time_of(is_complex, n_modes, np.array([1, 4]), 1.0) for _ in range(3)]
    rows = [(2.5 - k) * (one.rows + 0.3 * complex_normal(rng, one.rows.shape)) for k, one in enumerate(times)]
    data = [complex_normal(rng, (len(MEMBER),)) for _ in times]

    def fit(which: list[int]) -> tuple[Posterior, ComplexArray]:
        weights = np.concatenate([times[k].weights for k in which])
        matrix, values = np.concatenate([rows[k][MEMBER] for k in which]), np.concatenate([data[k] for k in which])
        precision, pull = (matrix.conj().T * weights) @ matrix, (matrix.conj().T * weights) @ values
        if not is_complex:
            precision, pull = 2 * precision.real, 2 * pull.real
        posterior = Posterior(pull, np.linalg.cholesky(precision + np.eye(n_modes)))
        return posterior, posterior.covariance @ pull

    def whitened(posterior: Posterior, mean: ComplexArray, fitted: bool) -> ComplexArray:
        design = rows[0] if is_complex else np.stack([rows[0].real, rows[0].imag])
        residual = (data[0] - (rows[0] @ mean)[MEMBER])[:, np.newaxis]
        return TimeWhitener.of(times[0].weights, MEMBER, model_root(posterior, design), fitted).rows(residual)

    beside, of_all = whitened(*fit([1, 2]), False), whitened(*fit([0, 1, 2]), True)
    np.testing.assert_allclose(of_all, beside, rtol=0, atol=1e-9)
    assert np.abs(of_all - whitened(*fit([0, 1, 2]), False)).max() > 0.1


COVARIANCES = {
    "regular": np.array([[2.0, 0.3], [0.3, 1.0]]),
    "singular": np.array([[1.0, 1.0], [1.0, 1.0]]),
    "of nothing": np.zeros((0, 0)),
}


@pytest.mark.parametrize("covariance", COVARIANCES.values(), ids=COVARIANCES)
def test_roots_give_the_covariance_back(covariance: FloatArray) -> None:
    root = root_of(covariance)
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-14)


def test_variances_that_rounding_made_negative_are_none() -> None:
    root = root_of(np.diag([1.0, -1e-16]))
    assert np.all(np.isfinite(root))
    np.testing.assert_allclose(root @ root.T, np.diag([1.0, 0.0]), atol=1e-15)
