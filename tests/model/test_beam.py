"""Beams by formula and by coefficients."""

import numpy as np
import pytest
from pyuvdata import ShortDipoleBeam
from pyuvdata.analytic_beam import UnpolarizedAnalyticBeam
from scipy.constants import c
from scipy.special import j1

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam, analytic_beam, of_formula

ZA = np.deg2rad(np.array([0.0, 3, 10, 40, 89]))
AZ = np.array([0.0, 1, 2, 3, 4])


def test_airy_beam_is_that_of_a_uniform_aperture():
    beam = analytic_beam("airy", 150e6, diameter=14.0)
    x = np.pi * 14.0 * 150e6 / c * np.sin(ZA[1:])
    np.testing.assert_allclose(beam(ZA, AZ)[1:], (2 * j1(x) / x) ** 2, rtol=1e-10)
    assert beam(ZA, AZ)[0] == pytest.approx(1)


def test_gaussian_beam_has_its_width():
    beam = analytic_beam("gaussian", 150e6, "nn", sigma=0.1, sigma_type="power")
    np.testing.assert_allclose(beam(ZA, AZ), np.exp(-(ZA**2) / (2 * 0.1**2)), rtol=1e-10)


def test_east_west_dipole_is_blind_along_east_west():
    beam = analytic_beam("short_dipole", 150e6, "ee")
    za, az = np.full(2, np.pi / 2), np.array([0.0, np.pi / 2])
    np.testing.assert_allclose(beam(za, az), [0, 1], atol=1e-12)
    np.testing.assert_allclose(analytic_beam("short_dipole", 150e6, "nn")(za, az), [1, 0], atol=1e-12)


@pytest.mark.parametrize("pol", ["ee", "nn", "en", "ne"])
@pytest.mark.parametrize("feeds", [["x", "y"], ["y", "x"]])
@pytest.mark.parametrize("x_orientation", ["east", "north"])
def test_dipole_is_the_same_whatever_its_feeds_are_called(pol: str, feeds: list[str], x_orientation: str) -> None:
    dipole = ShortDipoleBeam(x_orientation=x_orientation, feed_array=feeds)
    values = of_formula(dipole, "dipole", 150e6, pol)(ZA, AZ)
    np.testing.assert_allclose(values, analytic_beam("short_dipole", 150e6, pol)(ZA, AZ), atol=1e-12)


def test_formula_of_power_alone_is_taken_as_it_is() -> None:
    class Cosine(UnpolarizedAnalyticBeam):
        def _power_eval(self, *, az_grid: np.ndarray, za_grid: np.ndarray, f_grid: np.ndarray) -> np.ndarray:
            power = self._get_empty_data_array(az_grid.shape, beam_type="power")
            power[:] = np.cos(za_grid)
            return power

    for pol in ("ee", "en"):
        np.testing.assert_allclose(of_formula(Cosine(), "cosine", 150e6, pol)(ZA, AZ), np.cos(ZA), atol=1e-12)


def test_cross_polarised_beam_is_conjugate_when_feeds_swap():
    en, ne = analytic_beam("short_dipole", 150e6, "en"), analytic_beam("short_dipole", 150e6, "ne")
    assert np.iscomplexobj(en(ZA, AZ))
    assert not en.info.is_copol
    np.testing.assert_allclose(en(ZA, AZ), ne(ZA, AZ).conj())


@pytest.mark.parametrize("formula", ["airy", "gaussian", "uniform", "short_dipole"])
def test_copolarised_beam_is_real_and_one_at_zenith(formula):
    parameters = {} if formula in ("uniform", "short_dipole") else {"diameter": 5.0}
    values = analytic_beam(formula, 150e6, **parameters)(ZA, AZ)
    assert values.dtype == np.float64
    assert values[0] == pytest.approx(1)


@pytest.mark.parametrize(
    ("formula", "parameters", "words"),
    [("cosine", {}, "cosine.*airy"), ("airy", {"radius": 1.0}, "radius"), ("gaussian", {}, "gaussian")],
)
def test_bad_formula_is_told(formula, parameters, words):
    with pytest.raises(InputError, match=words):
        analytic_beam(formula, 150e6, **parameters)


@pytest.mark.parametrize("pol", ["ee", "en"])
def test_coefficient_beam_is_real_where_a_power_beam_is(pol):
    basis = FourierBessel([(1, 0), (2, 3)], form="complex")
    coeffs = np.array([1.0, 0.5j])
    beam = CoefficientBeam(basis, coeffs, BeamInfo("two modes", 1e8, pol))
    expected = coeffs @ basis.evaluate(ZA, AZ)
    np.testing.assert_allclose(beam(ZA, AZ), expected.real if pol == "ee" else expected, atol=1e-14)
    assert np.iscomplexobj(beam(ZA, AZ)) == (pol == "en")


@pytest.mark.parametrize("diameter", [1e-320, 1e-30, 1.0])
def test_a_dish_too_small_for_the_formula_is_refused(diameter: float) -> None:
    """The half-power angle of a Gaussian is an arcsine of wavelengths over the diameter."""
    with pytest.raises(
        InputError, match=rf"diameter = {diameter:g} does not exist at 131 MHz; give one of a wavelength"
    ):
        analytic_beam("gaussian", 131e6, "ee", diameter=diameter)
