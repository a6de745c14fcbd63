"""What effects change of the sky is seen as one sky after the other would be, however many are looked at at once."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.diffuse import Diffuse
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit import changed_sky as module
from hydrabeam_mpi.fit.changed_sky import SourcesOfChannels, changed_sky, design_of_each
from hydrabeam_mpi.model.engines.gemm import GemmEngine
from hydrabeam_mpi.random import generator
from tests.effects.small import small_block, small_setup

FREQS = np.array([100e6, 130e6])


@pytest.mark.parametrize("most", [1, 4, 7, 1000])
def test_designs_are_those_of_each_sky(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of none, few and many sources, and of sources that shine in one channel alone."""
    monkeypatch.setattr(module, "SOURCES_AT_ONCE", most)
    rng, basis = generator(1, "changed sky"), small_setup().basis
    engine = GemmEngine(rng.normal(0, 20, (5, 3)))
    skies = []
    for n in (0, 3, 1, 9, 2, 2, 0):
        flux = rng.normal(size=(2, n)) * (rng.uniform(size=(2, n)) < 0.7)
        skies.append(SourcesOfChannels(rng.uniform(0, 1.5, n), rng.uniform(0, 6, n), flux))
    found = list(design_of_each(engine, basis, skies, FREQS))
    assert len(found) == len(skies)
    for one, sky in zip(found, skies, strict=True):
        np.testing.assert_allclose(one, engine.design(basis, *sky, FREQS), rtol=0, atol=1e-11)


def test_channels_may_have_sources_of_their_own() -> None:
    """A quadrature of each channel's own, beside sources that all have in common."""
    setup, itime = small_setup(), 1
    place = setup.observation.lsts[1] + 0.1, setup.observation.latitude - 0.2
    missing = MissingSources([tuple(np.rad2deg(place))])
    listed = CatalogueFlux([tuple(np.rad2deg([setup.sky.ra[3], setup.sky.dec[3]]))])
    effects = [(Diffuse(2), np.ones(9)), (missing, np.eye(1, 4)[0]), (listed, np.array([0.5]))]
    blocks = [replace(small_block(setup, channel), sky_effects=effects) for channel in (0, 1)]
    za, az, flux = changed_sky(blocks, itime, [False, False, False])
    numbers = []
    for channel, block in enumerate(blocks):
        parts = [effect.extra_sky(block, itime, x) for effect, x in effects[:2]]
        assert all(part is not None for part in parts)
        sources = block.sources(itime)
        change = sources.flux_without() - sources.flux
        parts.append((sources.za, sources.az, change))
        expected = np.concatenate([np.stack(part)[:, part[2] != 0] for part in parts], axis=1)
        mine = np.stack([za, az, flux[channel]])[:, flux[channel] != 0]
        order = [np.lexsort(one) for one in (mine, expected)]
        np.testing.assert_array_equal(mine[:, order[0]], expected[:, order[1]])
        numbers.append(mine.shape[1])
    assert len(za) > max(numbers)
    alone = changed_sky(blocks, itime, [True, False, False])
    assert np.all(alone.flux != 0)
    assert all(one.size == two.size for one, two in pairwise((alone.za, alone.az, *alone.flux)))
