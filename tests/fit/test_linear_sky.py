"""Designs that are sums of what is kept are those of the sky itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.fit import row_model
from hydrabeam_mpi.fit.linear_sky import linear_sky
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.sampling.begin import begin
from tests.loop.mock import context_of
from tests.sampling.small import FLUX, GAINS, small_job

DIFFUSE = {"kind": "diffuse", "settings": {"l_max": 1}, "width": 0.1}


def drawn(values: Values) -> Values:
    """Return the same effects with parameters of their prior's size."""
    rng = generator(1, "values")
    return values.at(np.array([one * rng.standard_normal(len(one)) for one in map(values.prior_std, range(2))]))


def test_a_sum_of_slopes_is_the_design_of_the_sky(tmp_path: Path) -> None:
    """In two channels, each with its own diffuse emission; where something else of the sky moves it is worked out."""
    walk = begin(context_of(small_job(GAINS, FLUX, DIFFUSE, n_freqs=2), tmp_path))
    share, fitted = walk.context.train, walk.unknowns.values
    assert share.linear_sky is not None
    assert share.linear_sky.moving == (1, 2)
    values = drawn(fitted)
    plain = RankData(share.problem, share.setup, share.rows)
    expected = np.array(list(plain.designs(values)))
    np.testing.assert_allclose(list(share.designs(values)), expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert np.abs(expected - list(plain.designs(fitted))).max() > 1e-3 * np.abs(expected).max()
    plain.learn_sky(values, [2])
    other = values.at(1.5 * values.x)
    expected = np.array(list(RankData(share.problem, share.setup, share.rows).designs(other)))
    np.testing.assert_allclose(list(plain.designs(other)), expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_a_sky_that_bends_is_not_taken_for_a_sum(tmp_path: Path) -> None:
    """Fluxes and spectral indices of the same sources."""
    index: dict[str, Any] = {"kind": "spectral_index", "foremost": 2}
    share = begin(context_of(small_job(FLUX, index, n_freqs=2), tmp_path)).context.train
    assert share.linear_sky is None
    values = begin(context_of(small_job(FLUX, n_freqs=2), tmp_path)).unknowns.values
    assert linear_sky(share.designs, values, [0], [0, 1]) is not None


def test_skies_that_do_not_turn_make_up_the_sky_of_every_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside fluxes that change, in two channels; without room for them the sky is worked out at each time."""
    walk = begin(context_of(small_job(FLUX, DIFFUSE, n_freqs=2, n_times=10), tmp_path))
    share, values = walk.context.train, drawn(walk.unknowns.values)
    once = RankData(share.problem, share.setup, share.rows)
    found = np.array(list(once.designs(values)))
    assert [len(one) for one in once._skies.values()] == [4, 4]
    monkeypatch.setattr(row_model, "SLOPES_BYTES", 0)
    expected = np.array(list(RankData(share.problem, share.setup, share.rows).designs(values)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
