"""What scenes keep for one another is what each would have found by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.beam_visibilities import beam_visibilities
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.joined import join
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
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


@pytest.mark.parametrize("vectors", [np.zeros((1, 3)), np.array([[14.6, 0.0, 0.0], [0.0, 29.2, 1.0]])])
def test_a_beam_of_modes_is_seen_by_what_is_kept_of_these(vectors: np.ndarray) -> None:
    """Once for each basis: one that has grown, or has other modes, sees the sky anew."""
    memo: dict = {}
    basis, coeffs = EXPERIMENT.basis, EXPERIMENT.prior_mean[0]
    assert isinstance(basis, FourierBessel)
    others = basis.with_modes((k, m + 1) for k, m in basis.modes)
    beams = [(basis, coeffs), (basis, 0.7 * coeffs), (join([basis, others]), np.tile(coeffs, 2)), (others, coeffs)]
    for n_bases, (of, values) in zip((1, 1, 2, 3), beams, strict=True):
        beam = CoefficientBeam(of, values, BeamInfo("two", 1e8, "ee"))
        block = replace(small_block(EXPERIMENT), beam=beam)
        kept = beam_visibilities(replace(block, memo=memo), vectors)
        expected = beam_visibilities(block, vectors)
        assert len(memo) == n_bases
        np.testing.assert_allclose(kept, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
