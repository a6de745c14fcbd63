from __future__ import annotations

import numpy as np
import pytest
from scipy import special, stats

from hydrabeam_mpi.inference.significance import (
    chi2_sigma,
    correlation_sigma,
    f_sigma,
    kurtosis_sigma,
    log_p_of_looks,
    log_p_two_sided,
    sigma_of_log_p,
)
from hydrabeam_mpi.random import complex_normal, generator


@pytest.mark.parametrize("dof", [1, 2, 7.5, 200, 1e5])
def test_chi2_sigma_has_the_tail_probability(dof: float) -> None:
    sigma = np.linspace(-6, 9, 31)
    chi2 = np.where(sigma < 0, stats.chi2.ppf(stats.norm.cdf(sigma), dof), stats.chi2.isf(stats.norm.sf(sigma), dof))
    np.testing.assert_allclose(chi2_sigma(chi2, dof), sigma, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("dof", [2, 20, 2000, 2e6])
def test_chi2_sigma_goes_on_where_probabilities_underflow(dof: float) -> None:
    chi2 = dof + np.sqrt(2 * dof) * np.geomspace(1, 1e5, 300)
    sigma = chi2_sigma(chi2, dof)
    assert np.all(np.isfinite(sigma))
    assert np.all(np.diff(sigma) > 0)
    # Across the point where the tail probability is taken from its asymptotic form there is no step.
    far = np.flatnonzero(stats.chi2.sf(chi2, dof) < np.exp(-600))[0]
    steps = np.diff(sigma)[far - 3 : far + 2]
    assert steps.max() < 1.3 * steps.min()


def test_chi2_sigma_of_two_degrees_of_freedom_far_out() -> None:
    np.testing.assert_allclose(chi2_sigma(4000.0, 2), -special.ndtri_exp(-2000.0), rtol=1e-4)


@pytest.mark.parametrize("dof", [300.0, 17280.0, 1e6])
def test_deficits_of_chi2_go_on_where_probabilities_underflow(dof: float) -> None:
    """Smooth over the border, and in proportion to the root of the degrees of freedom beyond it."""
    chi2 = dof * np.linspace(1.0, 0.3, 2001)
    sigma = chi2_sigma(chi2, dof)
    steps = np.diff(sigma)
    assert (steps < 0).all()
    assert np.abs(np.diff(steps)).max() < 0.02 * np.abs(steps).max()
    assert sigma[-1] == pytest.approx(-np.sqrt(dof * (0.3 - 1 - np.log(0.3))), rel=0.01)


def test_nothing_is_significant_without_degrees_of_freedom() -> None:
    np.testing.assert_array_equal(chi2_sigma([0.0, 1.0], 0.0), 0.0)


def test_chi2_sigma_of_nothing_is_finite() -> None:
    assert np.isfinite(chi2_sigma(0.0, 4000))
    assert chi2_sigma(0.0, 4000) < -30


def test_f_sigma() -> None:
    assert f_sigma(float(stats.f.isf(stats.norm.sf(3.0), 12, 40)), (12, 40)) == pytest.approx(3.0)
    assert f_sigma(float(stats.f.ppf(stats.norm.cdf(-2.0), 12, 40)), (12, 40)) == pytest.approx(-2.0)
    huge = [f_sigma(ratio, (2000.0, 2000.0)) for ratio in (3.0, 5.0, 10.0, 100.0)]
    assert np.all(np.diff(huge) > 0)
    assert np.all(np.isfinite(huge))


def test_correlation_sigma_is_standard_normal_for_noise() -> None:
    one, two = complex_normal(generator(1, "pairs"), (2, 4000, 30))
    level = 0.5 * np.sum(np.abs(one) ** 2 + np.abs(two) ** 2, axis=1)
    found = [correlation_sigma(r, 30) for r in np.sum((one * two.conj()).real, axis=1) / level]
    assert stats.kstest(found, "norm").pvalue > 1e-3


def test_kurtosis_sigma_is_standard_normal_for_noise() -> None:
    power = np.abs(complex_normal(generator(2, "kurtosis"), (3000, 2000))) ** 2
    excess = 2000 * np.sum(power**2, axis=1) / np.sum(power, axis=1) ** 2 - 2
    found = np.array([kurtosis_sigma(one, 2000) for one in excess])
    assert abs(found.mean()) < 0.1
    assert abs(found.std() - 1) < 0.1
    assert np.abs(found).max() < 5


def test_looks() -> None:
    log_p = float(log_p_two_sided(5.0))
    assert np.exp(log_p) == pytest.approx(2 * stats.norm.sf(5.0))
    assert np.exp(log_p_of_looks(log_p, 1000)) == pytest.approx(-np.expm1(1000 * np.log1p(-np.exp(log_p))))
    assert log_p_of_looks(-1e5, 1000) == pytest.approx(-1e5 + np.log(1000))
    assert log_p_of_looks(0.0, 10) == 0.0
    assert sigma_of_log_p(float(stats.norm.logsf(3.0))) == pytest.approx(3.0)
