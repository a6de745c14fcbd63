"""What scenes keep for one another is what each would have found by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.ionosphere import Ionosphere, SteadyRefraction
from tests.effects.small import small_block, small_setup

EXPERIMENT = small_setup()
CALLS: list[int] = []


def columns(sources: Sources) -> np.ndarray:
    CALLS.append(len(sources.za))
    return np.stack([np.cos(sources.za), sources.za])


def test_integrals_without_a_beam_are_found_once_and_what_effects_change_of_the_sky_besides() -> None:
    memo: dict = {}
    brightest = int(np.argmax(EXPERIMENT.sky.flux[0]))
    place = tuple(float(np.rad2deg(axis[brightest])) for axis in (EXPERIMENT.sky.ra, EXPERIMENT.sky.dec))
    row_blocks: list[RowBlock] = []
    for channel in (0, 1):
        block = small_block(EXPERIMENT, channel)
        changed = replace(block, sky_effects=[(CatalogueFlux([place]), np.array([0.5]))])
        row_blocks += [replace(block, times=block.times[:3]), block, changed, block]
    CALLS.clear()
    for block in row_blocks:
        kept = replace(block, memo=memo).fixed_integral("test", columns)
        n_calls = len(CALLS)
        expected = block.integrate(columns)
        np.testing.assert_allclose(kept, expected, rtol=0, atol=1e-14 * np.abs(expected).max())
        del CALLS[n_calls:]
    # Three times, the three others, the one source that is changed of all; for both channels.
    assert len(CALLS) == 2 * (3 + 3 + 6)
    assert [n for n in CALLS if n < 2] == CALLS[6:12] + CALLS[18:]


def test_effects_of_one_kind_that_need_other_integrals_have_them_beside_each_other() -> None:
    """As refraction that drifts in one way away from the zenith, beside refraction of each time in another."""
    turn, flat = Ionosphere("turn"), SteadyRefraction("flat")
    both, (one, two) = small_block(EXPERIMENT), (small_block(EXPERIMENT) for _ in range(2))
    both.integrate_for([turn])
    both.integrate_for([flat])
    x = np.array([3.0, -2.0])
    np.testing.assert_array_equal(both.integral(turn), one.integral(turn))
    np.testing.assert_array_equal(flat.columns(both, x).values, flat.columns(two, x).values)
