"""What is tried: as large as the evidence wants it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument import basis_truncation
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Ended, Values
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.candidate_fits import TriedFit, as_large_as_wanted
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.trials import try_effects
from hydrabeam_mpi.loop.selection.weighing import rank
from tests.loop.mock import context_of, mock_job


def test_a_basis_grows_by_as_many_modes_as_the_evidence_wants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a basis that lacks some modes of the beam, which come three at a time."""
    monkeypatch.setattr(basis_truncation, "N_MODES", 3)
    monkeypatch.setattr(basis_truncation, "MOST_MODES", 18)
    context = context_of(mock_job(basis={"n_modes": 18}), tmp_path)
    fitted = refit(context, Values())
    (first,) = rank(context, fitted, [BasisTruncation(0, 3)], [])
    grown = as_large_as_wanted(context, fitted, first)
    assert first.finding is not None
    assert grown.finding is not None
    assert isinstance(grown.finding.effect, BasisTruncation)
    assert grown.finding.effect.n_modes > 3
    by_size = {n: attribute(context, fitted, [BasisTruncation(0, n)])[0].evidence for n in range(3, 19, 3)}
    best = max(by_size, key=lambda n: by_size[n].log_bayes_factor)
    assert grown.finding.effect.n_modes == best
    assert grown.log_bayes_factor == pytest.approx(by_size[best].log_bayes_factor, rel=1e-12)
    assert grown.log_bayes_factor > first.log_bayes_factor


def test_an_antenna_with_the_wrong_sign_is_found(tmp_path: Path) -> None:
    """Where its gain is far from one the linear model is no place to begin from."""
    gains = {"kind": "antenna_gains", "parameters": {"antenna 2 phase": np.pi}}
    context = context_of(mock_job(gains), tmp_path)
    fitted = refit(context, Values())
    found = try_effects(context, check(context, fitted), rank(context, fitted, [AntennaGains()], []), [])
    assert found is not None
    (active,) = found.after.fitted.values.active
    ln_amplitude, phase = active.x[0].reshape(-1, 2).T
    others = np.arange(len(phase)) != 2
    np.testing.assert_allclose(np.exp(1j * (phase[2] - phase[others])), -1, atol=0.02)
    assert np.ptp(ln_amplitude) < 0.02


def test_of_two_fits_the_one_with_more_evidence_is_better_if_it_has_converged(tmp_path: Path) -> None:
    """A source that a first fit has found is not given up for what its prior's next width leads a fit to."""
    context = context_of(mock_job(), tmp_path)
    before = refit(context, Values())
    (finding,) = attribute(context, before, [AntennaGains()])
    start = Active.start(finding.effect, context.setup, finding.evidence.prior_var, finding.evidence.x)
    one = TriedFit.of(context, before, refit(context, before.values.extended(start), before))
    more = replace(one, log_bayes_factor=one.log_bayes_factor + 1)
    assert more.is_better(one)
    assert not one.is_better(more)
    broken = replace(one.fitted, diagnostics=replace(one.fitted.diagnostics, ended=Ended.STUCK))
    lost = replace(more, fitted=broken)
    assert one.is_better(lost)
    assert not lost.is_better(one)
    assert lost.is_better(replace(lost, log_bayes_factor=one.log_bayes_factor))
