"""What is said of a posterior beam."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.result.summary import full_width, warnings_of

ZA = np.arange(91.0)


def test_full_width_is_that_of_a_shifted_gaussian():
    """2 sqrt(2 ln 2) sigma wherever the peak lies on the cut; linear interpolation errs by far less than a step."""
    forward, backward = (np.exp(-0.5 * ((sign * ZA - 3.0) / 5.0) ** 2) for sign in (1, -1))
    assert full_width(forward, backward) == pytest.approx(2 * np.sqrt(2 * np.log(2)) * 5.0, abs=0.02)
    assert full_width(backward, forward) == pytest.approx(full_width(forward, backward), rel=1e-12)


def test_full_width_of_a_wide_beam_ends_at_the_horizon():
    assert full_width(np.ones(91), np.ones(91)) == 180
    assert full_width(np.ones(91), 1 - ZA / 20) == pytest.approx(100)


GOOD = {
    "freq_hz": 150e6,
    "heldout_chi2_predictive": 1.1,
    "heldout_chi2_noise_only": 1.2,
    "heldout_chi2_unperturbed_scaled": 9.0,
    "heldout_amplitude_unperturbed": 1.01,
    "negative_fraction": 0.0,
    "imag_max": 0.0,
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"heldout_chi2_predictive": 4.0}, "the beam alone does not explain the data"),
        ({"heldout_chi2_predictive": 4.0}, "too small by a factor of up to 2 "),
        ({"heldout_chi2_noise_only": 10.0}, "At 150 MHz the model beam with one free amplitude"),
        ({"heldout_amplitude_unperturbed": 1.7}, "when it is 1.01 to 1.7 times as large"),
        ({"negative_fraction": 0.2}, "negative on up to 20.0% of the sky"),
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
    assert warnings_of([{"negative_fraction": 0.0, "imag_max": 0.0}]) == []
