"""Beams of complex coefficients: what effects change of the sky, and how fits of both converge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import ComplexArray
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.diffuse import Diffuse
from hydrabeam_mpi.effects.sky.horizon import Horizon
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Estimate, Values
from hydrabeam_mpi.random import generator
from tests.fit.test_gauss_newton import free
from tests.loop.mock import context_of, mock_job

COMPLEX = {"form": "complex", "n_modes": 24, "k_max": 12, "m_max": 2}
OF_THE_SKY: dict[str, Callable[[float, float], Effect]] = {
    "diffuse emission": lambda *_: Diffuse(l_max=2),
    "a missing source": lambda ra, dec: MissingSources([(ra + 1.0, dec)]),
    "a flux": lambda ra, dec: CatalogueFlux([(ra, dec)]),
    "an obstruction": lambda *_: Horizon(walls=[(0.0, 180.0, 0.0, 8.0)]),
}
"""Of the direction of a source of the catalogue, in degrees."""


def model(context: FitContext, at: Estimate) -> ComplexArray:
    """Return A b + E of all fitted rows, (Ntimes, Nbls)."""
    rows, added = context.train.calibrated(at)
    return np.concatenate([block.vis for _, block, _ in context.train.row_blocks(0, at, added[0], rows)])


def columns(context: FitContext, at: Estimate, one: Active) -> ComplexArray:
    """Return the columns of an effect's parameters in use, (Ntimes, Nbls, n)."""
    rows, added = context.train.calibrated(at)
    parts = []
    for _, block, _ in context.train.row_blocks(0, at, added[0], rows):
        found = block.columns_of(one.effect, one.x[0])
        matrix = found.matrix()
        dense = np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())
        dense = dense.reshape(*found.values.shape[:2], -1)[..., one.used]
        parts.append(block.spread(dense) if found.by_group else dense)
    return np.concatenate(parts)


@pytest.mark.parametrize("effect", OF_THE_SKY.values(), ids=OF_THE_SKY)
def test_columns_are_how_the_model_changes(effect: Callable[[float, float], Effect], tmp_path: Path) -> None:
    """By differences: with the real part of the beam alone they would miss what its imaginary part sees."""
    context = context_of(mock_job(basis=COMPLEX), tmp_path)
    sky = context.setup.sky
    index, za, _ = context.train.model.positions.above_horizon(0)
    near = index[np.argmin(za)]
    one = free(context, effect(*np.rad2deg([sky.ra[near], sky.dec[near]]).tolist()), 1.0)
    assert len(one.used)
    rng = generator(1, "imaginary parts")
    beams = []
    for beam in refit(context, Values()).fit.posteriors:
        size = 0.1 * np.abs(beam.mean)
        beams.append(
            replace(beam, mean=beam.mean + size * (rng.normal(size=len(size)) + 1j * rng.normal(size=len(size))))
        )
    at = Estimate(Values((one,)), tuple(beams))
    found, scale = columns(context, at, one), np.abs(one.effect.parameters(context.setup).scale)
    for place, number in enumerate(one.used.tolist()[:6]):
        step = 1e-3 * scale[number] * (np.arange(one.x.shape[1]) == number)
        ends = [replace(at, values=Values((replace(one, x=one.x + sign * step),))) for sign in (1, -1)]
        change = (model(context, ends[0]) - model(context, ends[1])) / (2 * step.sum())
        np.testing.assert_allclose(found[..., place], change, rtol=0, atol=1e-5 * np.abs(change).max())


def test_a_faint_sky_and_functions_that_the_beam_lacks_converge(tmp_path: Path) -> None:
    """They are factors of each other: where the one is not solved for beside the other a fit ends where it began."""
    sky = {"kind": "diffuse", "settings": {"l_max": 3}, "strength": 0.03}
    context = context_of(mock_job(sky, basis=COMPLEX | {"k_max": 24, "n_modes": 60}, prior={"fraction": 0.1}), tmp_path)
    before = refit(context, Values((free(context, Diffuse(l_max=3), 3.0),)))
    fitted = refit(context, before.values.extended(free(context, BasisTruncation(n_modes=64), 3.0)), before)
    assert fitted.diagnostics.converged
    assert fitted.diagnostics.train_chi2[0] < before.diagnostics.train_chi2[0]
