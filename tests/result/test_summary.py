"""What is said of a posterior beam."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.result.summary import GRID_AZ, GRID_ZA, eigenbeams, full_width
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
    "negative_beyond_errors": 0.0,
    "imag_max": 0.0,
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"heldout_chi2_predictive": 4.0}, "the beam alone does not explain the data"),
        ({"heldout_chi2_predictive": 4.0}, "too small by a factor of up to 2 "),
        ({"heldout_chi2_noise_only": 10.0}, "At 150 MHz the model beam with one free amplitude"),
        ({"heldout_amplitude_unperturbed": 1.7}, "when it is 1.01 to 1.7 times as large"),
        ({"negative_beyond_errors": 0.2}, "negative on up to 20.0% of the sky"),
        ({"imag_max": 0.01}, "imaginary parts up to 1.0e-02"),
    ],
)
def test_what_a_user_should_not_overlook_is_said(change, said):
    assert said in " ".join(warnings_of([GOOD, GOOD | change]))


def test_one_amplitude_is_told_as_one():
    assert "when it is 0.4 times as large" in " ".join(warnings_of([GOOD | {"heldout_amplitude_unperturbed": 0.4}]))


def test_a_good_result_and_one_without_heldout_data_need_no_warning():
    assert warnings_of([GOOD]) == []
    # The data leave the beam so uncertain that the noise is little beside it; the posterior says so itself.
    assert warnings_of([GOOD | {"heldout_chi2_noise_only": 676.0, "heldout_chi2_unperturbed_scaled": 9000.0}]) == []
    assert warnings_of([{"negative_beyond_errors": 0.0, "imag_max": 0.0}]) == []
