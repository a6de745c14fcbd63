"""Fluxes that sources cannot have, and what is left without those sources."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.effects.shared.point_sources import PointSources
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from tests.effects.small import small_setup

PLACES = [(10.0, -30.0), (20.0, -31.0), (30.0, -32.0)]
LIMITS: list[tuple[PointSources, list[float], list[float]]] = [
    (CatalogueFlux(PLACES), [-0.5, -1.0, 20.0], [0, 0, 0]),
    (CatalogueFlux(PLACES), [-0.5, -1.5, -9.6], [0, 5, 86]),
    (MissingSources(PLACES), [3.0, -2, 1, 0.5, -1, -1, 0, 0, 0], [0] * 9),
    (MissingSources(PLACES), [3.0, -2, 1, -18.4, -1, -1, -0.1, 0, 0], [0, 0, 0, 184, 0, 0, 1, 0, 0]),
    (MissingSources(PLACES[:2]), [3.0, -2, 1, -1, -1.0, -1, -1, -1], [0, 0, 0, 0, 10, 0, 0, 0]),
]


@pytest.mark.parametrize(("effect", "x", "expected"), LIMITS)
def test_a_flux_is_not_below_zero(effect: PointSources, x: list[float], expected: list[float]) -> None:
    """Whatever offsets and spectral indices are; errors are 0.1, the same in both channels."""
    std = np.full((2, len(x)), 0.1)
    np.testing.assert_allclose(effect.beyond(small_setup(), np.tile(x, (2, 1)), std), expected, atol=1e-9)
    assert not effect.beyond(small_setup(), np.tile(x, (2, 1)), np.zeros_like(std)).any()


@pytest.mark.parametrize(("kind", "each"), [(CatalogueFlux, 1), (MissingSources, 3), (MissingSources, 4)])
def test_other_sources_stay(kind: type[PointSources], each: int) -> None:
    gone = np.zeros(3 * each, dtype=bool)
    gone[each] = True
    effect, left = kind(PLACES, 50).without(gone)
    assert effect.describe() == {"sources": [list(PLACES[0]), list(PLACES[2])], "trials": 50}
    assert left.tolist() == [*range(each), *range(2 * each, 3 * each)]
