"""The total power that beams see, of which what their functions see is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.shared.beam_visibilities import beam_visibilities
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
from tests.effects.small import small_block, small_setup

SETUP = small_setup()
RNG = np.random.default_rng(1)


@pytest.mark.parametrize("form", ["real", "complex"])
def test_power_kept_for_many_beams_is_that_of_each(form: str) -> None:
    """Also where effects change fluxes of the sky and add sources to it, and where a block has other times."""
    basis = FourierBessel([(k, m) for k in range(1, 9) for m in range(-2, 3)], form=form)
    memo: dict = {}
    brightest = int(np.argmax(SETUP.sky.flux[0]))
    place = tuple(float(np.rad2deg(axis[brightest])) for axis in (SETUP.sky.ra, SETUP.sky.dec))
    effects = [(CatalogueFlux([place]), np.array([0.5]))]
    for sky_effects in ([], effects, []):
        for n_times in (3, None):
            coeffs = RNG.standard_normal(basis.n_modes) + (0.0 if form == "real" else 1j)
            beam = CoefficientBeam(basis, coeffs, BeamInfo("test", SETUP.observation.freqs[0], "ee"))
            block = replace(small_block(SETUP), beam=beam, sky_effects=sky_effects)
            block = replace(block, times=block.times[:n_times])
            seen = map(block.sources, block.times.tolist())
            expected = [0.5 * (one.flux_without() @ beam(one.za, one.az)) for one in seen]
            found = beam_visibilities(replace(block, memo=memo), np.zeros((1, 3)))[:, 0]
            # A table is off by a millionth of the highest modes.
            np.testing.assert_allclose(found.real, expected, rtol=0, atol=1e-6 * np.abs(expected).max())

    # By the end all times have been asked for again.
    assert [set(kept) for kept, _ in memo.values()] == [set(small_block(SETUP).times.tolist())]
