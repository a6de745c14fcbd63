"""What is said of a posterior beam."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import CovariancePrior, DiagonalPrior, FlatPrior
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.result.summary import GRID_AZ, GRID_ZA, departure_from_prior, eigenbeams, full_width
from hydrabeam_mpi.result.told import warnings_of

ZA = np.arange(91.0)


def test_full_width_is_that_of_a_shifted_gaussian():
    """2 sqrt(2 ln 2) sigma wherever the peak lies on the cut; linear interpolation errs by far less than a step."""
    forward, backward = (np.exp(-0.5 * ((sign * ZA - 3.0) / 5.0) ** 2) for sign in (1, -1))
    assert full_width(forward, backward) == pytest.approx(2 * np.sqrt(2 * np.log(2)) * 5.0, abs=0.02)
    assert full_width(backward, forward) == pytest.approx(full_width(forward, backward), rel=1e-12)


def test_full_width_of_a_wide_beam_ends_at_the_horizon():
    assert full_width(np.ones(91), np.ones(91)) == 180
    assert full_width(np.ones(91), 1 - ZA / 20) == pytest.approx(100)


@pytest.mark.parametrize("form", ["real", "complex"])
def test_eigenbeams_are_right_where_the_variances_span_more_than_a_double_resolves(form):
    """Variances from 1 to 1e-20, whose smallest are rounding errors beside the largest in the covariance."""
    rng = np.random.default_rng(3)
    basis = FourierBessel([(k, m) for k in range(1, 11) for m in (0, 2, -2)], form=form)
    n = basis.n_modes
    shape = rng.standard_normal((n, n)) + (1j * rng.standard_normal((n, n)) if form == "complex" else 0)
    vectors, _ = np.linalg.qr(shape)
    variances = np.geomspace(1e-20, 1.0, n)
    _, upper = np.linalg.qr((vectors / np.sqrt(variances)).conj().T)
    found, beams = eigenbeams(Posterior(np.zeros(n), upper.conj().T), basis)
    np.testing.assert_allclose(found, variances[:4], rtol=1e-6)
    za, az = 30, 45
    expected = vectors[:, :4].T @ basis.evaluate(np.array([GRID_ZA[za]]), GRID_AZ[[az]])[:, 0]
    np.testing.assert_allclose(np.abs(beams[:, za, az]), np.abs(expected), rtol=1e-5, atol=1e-9)


GOOD = {
    "freq_hz": 150e6,
    "heldout_chi2_predictive": 1.1,
    "heldout_chi2_noise_only": 1.2,
    "heldout_chi2_unperturbed_scaled": 9.0,
    "heldout_amplitude_unperturbed": 1.01,
    "heldout_rms_jy_noise": 0.01,
    "heldout_rms_jy_beyond_basis": 0.005,
    "negative_beyond_errors": 0.0,
    "imag_max": 0.0,
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"heldout_chi2_predictive": 4.0}, "the beam alone does not explain the data"),
        ({"heldout_chi2_predictive": 4.0}, "too small by a factor of up to 2 "),
        ({"heldout_chi2_noise_only": 10.0}, "At 150 MHz the model beam with one free amplitude"),
        ({"heldout_rms_jy_beyond_basis": 0.2}, "At 150 MHz the basis is too small for the model beam itself"),
        ({"heldout_rms_jy_beyond_basis": 0.2}, "leaves up to 0.2 Jy rms, where the noise is 0.01 Jy"),
        ({"heldout_amplitude_unperturbed": 1.7}, "when it is 1.01 to 1.7 times as large"),
        ({"heldout_amplitude_unperturbed": 0.506}, "what [data] pol_convention makes"),
        ({"negative_beyond_errors": 0.2}, "negative on up to 20.0% of the sky"),
        ({"prior_departure": 3.14, "prior_departure_log_evidence": 233.3}, "up to 3.1 times as far from the model"),
        ({"prior_departure": 3.14, "prior_departure_log_evidence": 233.3}, "more evidence, by about 233 in ln"),
        ({"imag_max": 0.01}, "imaginary parts up to 1.0e-02"),
    ],
)
def test_what_a_user_should_not_overlook_is_said(change, said):
    assert said in " ".join(warnings_of([GOOD, GOOD | change]))


def test_widths_that_the_data_chose_are_not_recommended():
    (stated,), (chosen,) = (warnings_of([GOOD | {"heldout_chi2_noise_only": 10.0}], chosen) for chosen in (False, True))
    assert "widths = 'evidence'" in stated
    assert "tell next to nothing of how the beam departs from its model" in chosen
    assert "widths" not in chosen


def test_what_the_basis_cannot_follow_is_not_put_down_to_the_prior():
    (said,) = warnings_of([GOOD | {"heldout_chi2_noise_only": 10.0, "heldout_rms_jy_beyond_basis": 0.2}])
    assert "rest = true" in said
    assert "widths" not in said


def test_one_amplitude_is_told_as_one():
    assert "when it is 0.4 times as large" in " ".join(warnings_of([GOOD | {"heldout_amplitude_unperturbed": 0.4}]))


def test_a_good_result_and_one_without_heldout_data_need_no_warning():
    assert warnings_of([GOOD]) == []
    # The data leave the beam so uncertain that the noise is little beside it; the posterior says so itself.
    assert warnings_of([GOOD | {"heldout_chi2_noise_only": 676.0, "heldout_chi2_unperturbed_scaled": 9000.0}]) == []
    assert warnings_of([{"negative_beyond_errors": 0.0, "imag_max": 0.0}]) == []


@pytest.mark.parametrize("kind", ["diagonal", "covariance"])
@pytest.mark.parametrize("scale", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("is_complex", [False, True])
def test_widths_of_the_prior_that_have_the_most_evidence(kind, scale, is_complex):
    """Coefficients are drawn ``scale`` times as far from the prior's mean as it says; beside some no data say anything.

    The gain is compared with the evidence of both priors as it is defined, ln N(d; F m0, F Sigma F^H + N).
    """
    rng = generator(3, kind, str(scale), str(is_complex))
    n, n_data, noise = 60, 200, 1e-3
    normal = partial(complex_normal, rng) if is_complex else rng.standard_normal
    design = normal((n_data, n))
    design[:, 50:] = 0  # seen by no data
    root = np.tril(normal((n, n))) / 8 + np.eye(n) if kind == "covariance" else np.diag(rng.uniform(0.5, 2, n))
    centre, sigma = normal((n,)), root @ root.conj().T
    data = design @ (centre + scale * root @ normal((n,))) + noise * normal((n_data,))

    def prior_of(widths: float):
        if kind == "diagonal":
            return DiagonalPrior(centre, widths * np.sqrt(np.diag(sigma).real))
        return CovariancePrior(centre, widths**2 * sigma)

    def log_evidence(widths: float) -> float:
        covariance = widths**2 * design @ sigma @ design.conj().T + noise**2 * np.eye(n_data)
        left = data - design @ centre
        loss = np.vdot(left, np.linalg.solve(covariance, left)).real + np.linalg.slogdet(covariance)[1]
        return -loss * (1 if is_complex else 0.5)

    precision = design.conj().T @ design / noise**2
    source = design.conj().T @ data / noise**2 + prior_of(1).precision_times(centre)
    prior_of(1).add_precision(precision)
    posterior = Posterior(np.linalg.solve(precision, source), np.linalg.cholesky(precision))
    departure, gain = departure_from_prior(posterior, prior_of(1))
    assert departure == pytest.approx(scale, rel=0.35)
    assert gain == pytest.approx(log_evidence(departure) - log_evidence(1), abs=0.01)
    for other in (0.8 * departure, 1.25 * departure):
        assert log_evidence(other) < log_evidence(departure)


def test_nothing_departs_from_a_flat_prior():
    assert departure_from_prior(Posterior(np.ones(3), np.eye(3)), FlatPrior(np.zeros(3))) == (1.0, 0.0)
