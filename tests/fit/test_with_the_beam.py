"""What a tilted or displaced antenna adds is in proportion to the beam, which steps and evidence know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_pointing import AntennaPointing
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.blocks import CandidateBlock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.fit.with_the_beam import ADDED
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks, candidate_sums, marginal_of
from tests.loop.mock import context_of, mock_job

TILTED = {"kind": "antenna_pointing", "parameters": {"antenna 3 tilted towards East": 1.0}}
MOVED = {"kind": "antenna_positions", "parameters": {"antenna 3 displaced East": 0.2}}
COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.5}}
COUPLING = CrossCoupling([[1, 4]])
CASES = {
    "tilted": ((TILTED,), (AntennaPointing(),)),
    "elsewhere": ((MOVED,), (AntennaPositions(),)),
    "and something that no beam sees": ((TILTED, COUPLED), (AntennaPointing(), COUPLING)),
}


def fit(context: FitContext, effects: tuple[Effect, ...]) -> Fitted:
    """Fit the parameters of antenna 3, and those of what is not of antennas."""
    active = []
    for effect in effects:
        parameters = effect.parameters(context.setup)
        used = [effect is COUPLING or name.startswith("antenna 3 ") for name in parameters.names]
        prior_var = np.where(used, parameters.scale**2, 0.0)
        active.append(Active.start(effect, context.setup, prior_var, np.zeros((1, len(parameters)))))
    return refit(context, Values(tuple(active)))


def marginal_beside_gains(context: FitContext, fitted: Fitted) -> Marginal:
    gains = AntennaGains()
    cached = CachedRowBlocks.of(context, fitted.estimate)
    block = CandidateBlock(gains, np.zeros(len(gains.parameters(context.setup))))
    return marginal_of(context, fitted, candidate_sums(context, fitted.values, cached, 0, {"gains": block}), 0)


@pytest.mark.parametrize("form", ["real", "complex"])
@pytest.mark.parametrize(("injected", "effects"), CASES.values(), ids=CASES)
def test_a_scale_of_all_gains_is_one_of_the_beam(
    injected: tuple[dict[str, object], ...], effects: tuple[Effect, ...], form: str, tmp_path: Path
) -> None:
    """Whatever antennas there are: the beam follows by as much, and the data tell next to nothing of it."""
    context = context_of(mock_job(*injected, basis={"form": form}, prior={"fraction": 30.0}), tmp_path)
    fitted = fit(context, effects)
    assert fitted.diagnostics.converged
    marginal = marginal_beside_gains(context, fitted)
    (beam,), names, scale = fitted.fit.posteriors, ["gains"], AntennaGains().degenerate_directions(context.setup)[0]
    scale = scale / scale.max()
    if COUPLING in effects:
        # It is multiplied with gains as well.
        names, scale = ["gains", "1 cross_coupling"], np.append(scale, -2 * fitted.values.active[1].x)
    followed = marginal.response(names) @ scale
    np.testing.assert_allclose(followed, -2 * beam.mean, rtol=0, atol=1e-4 * np.abs(beam.mean).max())
    told = marginal.likelihood(names)
    assert scale @ told.information @ scale < 1e-6 * scale @ told.signal @ scale
    # With E as it is the visibilities of one antenna would tell the scale.
    plain = Marginal(marginal.sums, "beam", beam).likelihood(names).information
    assert scale @ plain @ scale > 100 * scale @ told.information @ scale


def test_nothing_goes_with_the_beam_where_nothing_is_added(tmp_path: Path) -> None:
    context = context_of(mock_job(COUPLED), tmp_path)
    marginal = marginal_beside_gains(context, fit(context, (COUPLING,)))
    assert ADDED not in marginal.sums.blocks
