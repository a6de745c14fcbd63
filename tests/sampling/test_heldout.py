"""How well draws predict held-out rows: of each draw, and of all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from hydrabeam_mpi.random import generator
from hydrabeam_mpi.sampling.begin import begin
from hydrabeam_mpi.sampling.heldout import heldout_of
from hydrabeam_mpi.sampling.predictive import check_heldout
from hydrabeam_mpi.sampling.status import status_of
from tests.loop.mock import context_of
from tests.sampling.made import draw_of, new_store
from tests.sampling.small import COUPLING, GAINS, drawn_from_prior, model_of, small_job


@pytest.mark.parametrize("more", [{}, {"noise_groups": "antenna", "noise_dof": 3.0}], ids=["Gaussian", "of antennas"])
def test_a_draw_is_compared_with_what_is_held_out(more: dict[str, Any], tmp_path: Path) -> None:
    """With the densities that scipy has of Gaussians and Student's t in two dimensions."""
    job = small_job(GAINS, COUPLING, blocks=("noise",), noise_prior=[4.0, 6.0], **more)
    walk = begin(context_of(job, tmp_path))
    state, context = drawn_from_prior(walk, generator(3, "state")), walk.context
    # Of the held-out rows as if they were those that are fitted.
    rows = context.test.rows
    away = rows.data - model_of(replace(walk, context=replace(context, train=context.test)), state.values, state.beams)
    told = check_heldout(walk, state)
    assert set(rows.tile.times.tolist()) == {1, 3, 5}
    assert told["heldout_rms"] == pytest.approx(np.sqrt(np.mean(np.abs(away) ** 2)))
    assert told["heldout_chi2"] == pytest.approx(np.mean(np.abs(away) ** 2 * rows.inv_noise_var))
    one, two = context.setup.observation.antenna_index[rows.tile.bls].T
    scale = state.parts[:, one] * state.parts[:, two] if more else state.noise[:, np.newaxis]
    log_density = 0.0
    for residual, variance in zip(away.ravel(), (scale[:, np.newaxis] / rows.inv_noise_var).ravel(), strict=True):
        at, shape = [residual.real, residual.imag], 0.5 * variance * np.eye(2)
        log_density += (
            multivariate_t.logpdf(at, shape=shape, df=3.0) if more else multivariate_normal.logpdf(at, cov=shape)
        )
    assert told["heldout_log_density"] == pytest.approx(log_density)


def test_nothing_is_told_where_nothing_is_held_out(tmp_path: Path) -> None:
    walk = begin(context_of(small_job() | {"holdout": {"kind": "none"}}, tmp_path))
    assert check_heldout(walk, drawn_from_prior(walk, generator(3, "state"))) == {}


def test_draws_are_summed_up(tmp_path: Path) -> None:
    """After the warm-up, of all chains."""
    store = new_store(tmp_path, chains=2, draws=2, warm_up=1)
    assert heldout_of(store) is None
    log_densities = {0: [9.0, -1001.0, -1002.0], 1: [9.0, -1003.0, -1001.5]}
    for chain, values in log_densities.items():
        with store.writer(chain) as writer:
            for number, value in enumerate(values):
                info = {"heldout_rms": 2.0 + chain, "heldout_chi2": 1.1, "heldout_log_density": value}
                writer.append(draw_of(chain, number), {}, {"seconds": 0.5, **info})
    found = heldout_of(store)
    assert found is not None
    assert (found.rms, found.rms_std, found.chi2) == pytest.approx((2.5, 0.5, 1.1))
    assert found.log_density == pytest.approx(-1001.875)
    assert found.log_predictive == pytest.approx(-1001.875 + np.log(np.mean(np.exp([0.875, -0.125, -1.125, 0.375]))))
    assert "held-out rows: rms 2.5 +- 0.5 Jy" in str(status_of(store))
