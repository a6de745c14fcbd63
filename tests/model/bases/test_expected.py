"""How far a beam may be from a formula, mode by mode."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.model.beam import analytic_beam
from hydrabeam_mpi.model.fit import beam_pixels, fit_basis
from hydrabeam_mpi.tables import embedded_beam


@pytest.mark.parametrize(("formula", "diameter"), [("airy", 12.0), ("airy", 14.0), ("gaussian", 12.0)])
@pytest.mark.parametrize("basis", [FourierBessel.full(40, 16), Zernike(40)], ids=["Fourier-Bessel", "Zernike"])
def test_widths_suit_a_simulated_beam(formula: str, diameter: float, basis: LinearBasis) -> None:
    """HERA's Vivaldi feed is no further from a formula than its widths say: by the formula's own a million times."""
    true = fit_basis(basis, beam_pixels(embedded_beam())).coeffs
    model = fit_basis(basis, beam_pixels(analytic_beam(formula, 131e6, diameter=diameter))).coeffs
    widths = basis.expected(basis.amplitudes(model))
    assert 0.15 < np.sqrt(np.mean(((true - model) / widths) ** 2)) < 0.8
    assert np.mean(abs(true - model) < 3 * widths) > 0.98


def test_other_models_are_taken_as_they_are() -> None:
    basis = FourierBessel.full(30, 8)
    amplitudes = basis.amplitudes(fit_basis(basis, beam_pixels(embedded_beam())).coeffs)
    np.testing.assert_array_equal(basis.expected(amplitudes), amplitudes)
    np.testing.assert_array_equal(basis.expected(np.zeros(basis.n_modes)), 0)
