"""What is tried: as large as the evidence wants it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydrabeam_mpi.effects.instrument import basis_truncation
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.trials import as_large_as_wanted
from hydrabeam_mpi.loop.selection.weighing import rank
from tests.loop.mock import context_of, mock_job


def test_a_basis_grows_by_as_many_modes_as_the_evidence_wants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a basis that lacks some modes of the beam, which come three at a time."""
    monkeypatch.setattr(basis_truncation, "N_MODES", 3)
    context = context_of(mock_job(basis={"n_modes": 18}), tmp_path)
    fitted = refit(context, Values())
    (first,) = rank(context, fitted, [BasisTruncation(0, 3)], [])
    grown = as_large_as_wanted(context, fitted, first)
    assert first.finding is not None
    assert grown.finding is not None
    assert isinstance(grown.finding.effect, BasisTruncation)
    assert grown.finding.effect.n_modes > 3
    by_size = {n: attribute(context, fitted, [BasisTruncation(0, n)])[0].evidence for n in range(3, 13, 3)}
    best = max(by_size, key=lambda n: by_size[n].log_bayes_factor)
    assert grown.finding.effect.n_modes == best
    assert grown.log_bayes_factor == by_size[best].log_bayes_factor > first.log_bayes_factor
