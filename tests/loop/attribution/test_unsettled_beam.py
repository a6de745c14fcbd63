"""Evidence where a fit has ended before its beam was the likeliest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Ended, Fitted, Values
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.random import generator
from tests.loop.mock import context_of, mock_job

COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.8}}


def evidence_of(context: FitContext, fitted: Fitted) -> float:
    (found,) = attribute(context, fitted, [CrossCoupling([(1, 4)])], CachedRowBlocks.of(context, fitted.estimate))
    return found.evidence.log_bayes_factor


@pytest.mark.parametrize("form", ["real", "complex"])
def test_what_the_beam_would_take_up_is_no_evidence(form: str, tmp_path: Path) -> None:
    """Of an effect that does not depend on the beam it is the same wherever that is."""
    context = context_of(mock_job(COUPLED, basis={"form": form, "n_modes": 24, "k_max": 12, "m_max": 2}), tmp_path)
    fitted = refit(context, Values())
    rng, moved = generator(1, "moved"), []
    for beam in fitted.fit.posteriors:
        step = 5 * beam.std * rng.normal(size=len(beam.mean))
        moved.append(replace(beam, mean=beam.mean + (step * (1 + 1j) if form == "complex" else step)))
    away = replace(fitted, fit=fitted.fit.with_beams(tuple(moved)))
    away = replace(away, diagnostics=replace(fitted.diagnostics, ended=Ended.STUCK))
    right = evidence_of(context, fitted)
    assert right > 100
    assert evidence_of(context, away) == pytest.approx(right, rel=1e-6)
    taken_for_settled = replace(away, diagnostics=replace(away.diagnostics, ended=Ended.CONVERGED))
    assert abs(evidence_of(context, taken_for_settled) - right) > 1e-4 * right
