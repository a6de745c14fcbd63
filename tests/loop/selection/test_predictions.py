"""What a fit predicts of the held-out rows, where that is a number."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, refit
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.loop.selection.first_and_last import _told_in_a_line
from hydrabeam_mpi.loop.selection.predictions import check, score_of
from tests.fit.test_gauss_newton import free
from tests.loop.mock import context_of, mock_job


@pytest.mark.mpi
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_prediction_beyond_all_numbers_is_no_prediction(comm: MPI.Comm, common_tmp_path: Path) -> None:
    """Such as a source may lead to that grows without end between the times that are fitted; far off is another."""
    context = context_of(mock_job(), common_tmp_path, comm)
    latitude = np.rad2deg(context.setup.observation.latitude)
    lst = np.rad2deg(context.setup.observation.lsts[context.problem.test.times[0]])
    fitted = refit(context, Values((free(context, MissingSources([(lst, latitude)]), 1e-4),)))
    (source,) = fitted.values.active

    def with_flux(flux: float) -> Fitted:
        x = np.where(np.arange(source.x.shape[1]) == 0, flux, source.x)
        return replace(fitted, values=replace(fitted.values, active=(replace(source, x=x),)))

    # A variance of 1e16 beside that of noise would be at the end of doubles: there rounding decides.
    for flux in (1.0, 1e6):
        checked = check(context, with_flux(flux))
        assert np.isfinite(checked.score.chi2)
        assert np.isfinite(checked.remains.structures["singular_values"]).all()
    for predict, flux in product((check, score_of), (1e18, 1e45)):
        with pytest.raises(BrokenOff, match="beyond all numbers"):
            predict(context, with_flux(flux))


def test_where_no_other_fit_stands_in_a_line_says_what_is_behind() -> None:
    with pytest.raises(InputError, match=r"\[prior\]: leaves some modes free"), _told_in_a_line():
        raise BrokenOff("beyond all numbers") from InputError("leaves some modes free", field="[prior]")
    with pytest.raises(InputError, match=r"held-out data: beyond all numbers; compare \[noise\]"), _told_in_a_line():
        raise BrokenOff("beyond all numbers")
