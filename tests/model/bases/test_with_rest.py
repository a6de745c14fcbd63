"""All that a model beam has beyond few functions, as one more of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from astropy_healpix import HEALPix

from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.healpix_map import HealpixMap
from hydrabeam_mpi.model.bases.rest import Rest
from hydrabeam_mpi.model.bases.rings import Pixels
from hydrabeam_mpi.model.bases.with_rest import WithRest
from hydrabeam_mpi.model.beam import BeamInfo, SampledBeam
from hydrabeam_mpi.model.fit import FittedBeam, fit_beam, rest_of
from hydrabeam_mpi.model.perturb import PerturbedBeam
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.tables import embedded_beam

EDGE = np.deg2rad(92)


def fitted(rest: bool, **settings: object) -> FittedBeam:
    few = {"n_modes": 60, "k_max": 12, "m_max": 4, "edge": EDGE, "boundary": "neumann"} | settings
    return fit_beam(embedded_beam(), FourierBessel.selection(rest=rest, **few))  # type: ignore[arg-type]


@pytest.mark.parametrize("form", ["real", "complex"])
def test_the_model_beam_is_whole(form: str) -> None:
    """Between the samples, too, and down to the horizon; the others' coefficients are as without."""
    without, fit = fitted(False, form=form), fitted(True, form=form)
    assert isinstance(fit.basis, WithRest)
    assert fit.basis.n_modes == without.basis.n_modes + 1
    np.testing.assert_array_equal(fit.coeffs[:-1], without.coeffs)
    assert fit.rms_residual < 1e-3 * without.rms_residual
    za, az = generator(1, "rest").uniform(0, [[np.pi / 2], [2 * np.pi]], (2, 500))
    left = np.abs(fit.basis.synthesize(fit.coeffs, za, az) - embedded_beam()(za, az))
    assert left.max() < 1e-2 * without.max_residual
    # Of the size that the other functions have, so that widths of a prior compare.
    size = np.sqrt(np.mean(np.abs(fit.basis.evaluate(za, az)) ** 2, axis=1))
    assert 0.3 < size[-1] / np.median(size[:-1]) < 3
    table = fit.basis.table(fit.coeffs)
    assert table is not None
    np.testing.assert_allclose(table(za, az), fit.basis.synthesize(fit.coeffs, za, az).real, rtol=0, atol=1e-7)


def healpix_beam() -> SampledBeam:
    """A beam on a HEALPix map that is round but for its squint, with a sidelobe."""
    pixels = HEALPix(32)
    longitude, latitude = (one.rad for one in pixels.healpix_to_lonlat(np.arange(pixels.npix)))
    za, az = np.pi / 2 - latitude, np.mod(longitude, 2 * np.pi)
    values = np.exp(-8 * za**2) * (1 + 0.3 * za * np.cos(az)) + 0.02 * np.sin(3 * za) ** 2
    up = za <= np.pi / 2
    interpolate = HealpixMap(32, "ring", np.arange(pixels.npix), values)
    return SampledBeam(interpolate, Pixels(za[up], az[up], values[up]), BeamInfo("map", 150e6, "ee"))


@pytest.mark.parametrize("known", ["as one more function", "as what is left of a fit", "restored"])
def test_a_beam_between_the_pixels_of_a_map_is_whole(known: str) -> None:
    """It bends at every line between the centres of pixels, where a table of it is off by 1e-4 of its peak and more."""
    beam, basis = healpix_beam(), FourierBessel.full(8, 2, form="real", edge=EDGE, boundary="neumann")
    za, az = generator(2, "map").uniform(0, [[np.pi / 2], [2 * np.pi]], (2, 2000))
    if known == "as one more function":
        fit = fit_beam(beam, replace(FourierBessel.selection(40, "real", k_max=8, m_max=2, edge=EDGE), rest=True))
        found = fit.basis.synthesize(fit.coeffs, za, az)
    else:
        fit = fit_beam(beam, basis)
        rest = rest_of(beam, basis, fit.coeffs)
        assert rest is not None
        if known == "restored":
            rest = Rest.from_description(rest.describe())
        found = basis.synthesize(fit.coeffs, za, az) + rest.columns(za, az)[0]
    np.testing.assert_allclose(found, beam(za, az), rtol=0, atol=1e-6)


def test_another_beam_has_its_part_of_the_rest() -> None:
    fit = fitted(True)
    assert fit_beam(embedded_beam(), fit.basis).coeffs == pytest.approx(fit.coeffs)
    other = fit_beam(PerturbedBeam(embedded_beam(), 1, (1.01, 1.01), 0.0), fit.basis)
    assert 0.5 < other.coeffs[-1] / fit.coeffs[-1] < 1.5


def test_next_functions_are_those_without_the_rest() -> None:
    fit, without = fitted(True), fitted(False)
    assert fit.basis.orders.shape == (fit.basis.n_modes, 2)
    sizes = fit.basis.amplitudes(fit.coeffs)
    assert fit.basis.expected(sizes).shape == sizes.shape
    found = fit.basis.next_modes(sizes, 0, 5)
    wanted = without.basis.next_modes(without.basis.amplitudes(without.coeffs), 0, 5)
    assert found is not None
    assert wanted is not None
    assert found.modes == wanted.modes


def test_where_nothing_is_left_there_is_no_rest() -> None:
    basis = FourierBessel.full(6, 2, edge=EDGE, boundary="neumann")
    coeffs = generator(2, "rest").standard_normal(basis.n_modes)

    def beam(za: np.ndarray, az: np.ndarray) -> np.ndarray:
        return np.asarray(basis.synthesize(coeffs, za, az))

    whole = FourierBessel.selection(None, "real", 6, 2, rest=True, edge=EDGE, boundary="neumann")
    assert isinstance(fit_beam(beam, whole).basis, FourierBessel)
