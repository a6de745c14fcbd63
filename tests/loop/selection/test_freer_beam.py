"""What a beam that is less free than stated leaves to an effect is asked of one that is as free."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.loop.selection.freer_beam import refusal_by_freer_beam
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
NARROW, WIDE = PriorWidths(1e-3), PriorWidths(1e3)


def fits(context: FitContext, widths: PriorWidths | None) -> tuple[Fitted, Fitted]:
    """Fits without the gain and with it."""
    n = len(AntennaGains().parameters(context.setup))
    start = Active.start(AntennaGains(), context.setup, np.full(n, 0.1**2), np.zeros((1, n)))
    one, two = (refit(context, Values(active, prior_widths=widths)) for active in ((), (start,)))
    return one, two


@pytest.mark.mpi
def test_what_is_so_is_not_refused_and_its_opposite_is(comm: MPI.Comm, common_tmp_path: Path) -> None:
    context = context_of(mock_job(GAIN), common_tmp_path, comm)
    before, after = fits(context, NARROW)
    assert refusal_by_freer_beam(context, before, after) is None
    opposite = replace(after, values=after.values.at(-after.values.x))
    told = refusal_by_freer_beam(context, before, opposite)
    assert told is not None
    assert "likelier without it" in told


@pytest.mark.mpi
@pytest.mark.parametrize("widths", [None, WIDE], ids=["stated", "wider"])
def test_a_beam_that_is_free_is_not_asked(widths: PriorWidths | None, comm: MPI.Comm, common_tmp_path: Path) -> None:
    context = context_of(mock_job(GAIN), common_tmp_path, comm)
    before, after = fits(context, widths)
    opposite = replace(after, values=after.values.at(-after.values.x))
    assert refusal_by_freer_beam(context, before, opposite) is None
