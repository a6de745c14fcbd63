from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.sky.spectral_index import SpectralIndex
from tests.effects.small import small_block, small_setup


def test_equals_another_catalogue() -> None:
    """With fluxes and indices wrong at the mean frequency."""
    setup = small_setup()
    index, x, a = [4, 17, 42], np.array([0.3, -0.2, 0.5]), np.array([0.7, 0.0, -2.0])
    effect = SpectralIndex(np.rad2deg([setup.sky.ra[index], setup.sky.dec[index]]).T.tolist())
    flux = setup.sky.flux.copy()
    flux[:, index] *= (1 + x) * (setup.observation.freqs[:, np.newaxis] / 141e6) ** a
    for channel in (0, 1):
        block = small_block(setup, channel)
        other = small_block(setup, channel, sky=replace(setup.sky, flux=flux))
        added = effect.added(block, np.stack([x, a], axis=1).ravel())
        np.testing.assert_allclose(block.vis + added, other.vis, rtol=0, atol=1e-11 * np.abs(block.vis).max())


def test_no_source_is_as_steep_as_that() -> None:
    """Nor has one a flux below zero; a fit may begin with any index, of which the factor stays a number."""
    setup = small_setup()
    effect = SpectralIndex(np.rad2deg([setup.sky.ra[:3], setup.sky.dec[:3]]).T.tolist())
    x, std = np.array([[0.5, 2.0, -1.5, -1.0, 0.1, -4.0]]), np.full((1, 6), 0.1)
    np.testing.assert_allclose(effect.beyond(setup, x, std), [0, 0, 5, 0, 0, 10])
    assert effect.without(effect.beyond(setup, x, std) > 0)[0].sources == effect.sources[:1]
    with np.errstate(over="raise"):
        factor = effect.sky_factor(setup, small_block(setup, 0).sources(0), np.array([0, 1e6, 0, -1e6, 0, 0]))
    assert np.all(np.isfinite(factor))
