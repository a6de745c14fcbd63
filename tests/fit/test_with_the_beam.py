"""What a tilted or displaced antenna adds is in proportion to the beam, which steps and evidence know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_pointing import AntennaPointing
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.common_beam import CommonBeam
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.blocks import CandidateBlock, ColumnBlock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import NormalEquations
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.fit.with_the_beam import ADDED
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks, candidate_sums, marginal_of
from tests.loop.mock import context_of, mock_job

TILTED = {"kind": "antenna_pointing", "parameters": {"antenna 3 tilted towards East": 1.0}}
MOVED = {"kind": "antenna_positions", "parameters": {"antenna 3 displaced East": 0.2}}
COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.5}}
COUPLING, COMMON = CrossCoupling([[1, 4]]), CommonBeam()
CASES = {
    "tilted": ((TILTED,), (AntennaPointing(),)),
    "elsewhere": ((MOVED,), (AntennaPositions(),)),
    "and something that no beam sees": ((TILTED, COUPLED), (AntennaPointing(), COUPLING)),
    "beams of two channels": ((TILTED,), (AntennaPointing(), COMMON)),
}


def fit(context: FitContext, effects: tuple[Effect, ...]) -> Fitted:
    """Fit the parameters of antenna 3, and those of what is not of antennas."""
    active = []
    for effect in effects:
        parameters = effect.parameters(context.setup)
        used = [effect in (COUPLING, COMMON) or name.startswith("antenna 3 ") for name in parameters.names]
        prior_var = np.where(used, parameters.scale**2, 0.0)
        active.append(
            Active.start(
                effect, context.setup, prior_var, np.zeros((context.setup.observation.Nfreqs, len(parameters)))
            )
        )
    return refit(context, Values(tuple(active)))


def sums_beside_gains(context: FitContext, fitted: Fitted) -> tuple[NormalEquations, dict[str, ColumnBlock]]:
    gains = AntennaGains()
    cached = CachedRowBlocks.of(context, fitted.estimate)
    more = {"gains": CandidateBlock(gains, np.zeros(len(gains.parameters(context.setup))))}
    return candidate_sums(context, fitted.values, cached, 0, more), {**fitted.values.blocks, **more}


@pytest.mark.parametrize("form", ["real", "complex"])
@pytest.mark.parametrize(("injected", "effects"), CASES.values(), ids=CASES)
def test_a_scale_of_all_gains_is_one_of_the_beam(
    injected: tuple[dict[str, object], ...], effects: tuple[Effect, ...], form: str, tmp_path: Path
) -> None:
    """Whatever antennas there are: the beam follows by as much, and the data tell next to nothing of it."""
    freqs = (131e6, 151e6) if COMMON in effects else (131e6,)
    context = context_of(mock_job(*injected, basis={"form": form}, prior={"fraction": 30.0}, freqs=freqs), tmp_path)
    fitted = fit(context, effects)
    assert fitted.diagnostics.converged
    sums, blocks = sums_beside_gains(context, fitted)
    marginal = marginal_of(context, fitted, sums, 0, blocks)
    names, beam, scale = ["gains"], fitted.fit.posteriors[0], AntennaGains().degenerate_directions(context.setup)[0]
    scale = scale / scale.max()
    for number, one in enumerate(fitted.values.active):
        # It is multiplied with gains as well, or part of the beam.
        if one.effect in (COUPLING, COMMON):
            names, scale = [*names, f"{number} {one.kind}"], np.append(scale, -2 * one.x[0])
    followed = marginal.response(names) @ scale
    np.testing.assert_allclose(followed, -2 * beam.mean, rtol=0, atol=1e-4 * np.abs(beam.mean).max())
    told = marginal.likelihood(names)
    assert scale @ told.information @ scale < 1e-6 * scale @ told.signal @ scale
    # With E as it is the visibilities of one antenna would tell the scale.
    plain = Marginal(sums, "beam", beam).likelihood(names).information
    assert scale @ plain @ scale > 100 * scale @ told.information @ scale


@pytest.mark.parametrize("form", ["real", "complex"])
def test_what_channels_have_in_common_is_part_of_the_beam_of_each(form: str, tmp_path: Path) -> None:
    """One channel tells it from its own beam no better beside a tilted antenna."""
    job = mock_job(TILTED, basis={"form": form}, prior={"fraction": 30.0}, freqs=(131e6, 151e6))
    context = context_of(job, tmp_path)
    fitted = fit(context, (AntennaPointing(), COMMON))
    sums, blocks = sums_beside_gains(context, fitted)
    marginal = marginal_of(context, fitted, sums, 0, blocks)
    # In directions that the data hardly tell the beam's own prior keeps it; its size they tell best.
    beam = fitted.fit.posteriors[0].mean
    x = np.concatenate([beam.real, beam.imag]) if form == "complex" else beam
    followed = marginal.response(["1 common_beam"]) @ x
    np.testing.assert_allclose(followed, -beam, rtol=0, atol=1e-4 * np.abs(beam).max())


def test_nothing_goes_with_the_beam_where_nothing_is_added(tmp_path: Path) -> None:
    context = context_of(mock_job(COUPLED), tmp_path)
    sums, _ = sums_beside_gains(context, fit(context, (COUPLING,)))
    assert ADDED not in sums.blocks
