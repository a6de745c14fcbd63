"""What chains draw has the posterior that dense algebra and quadrature give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.stats import ks_2samp, kstest, multivariate_normal

from hydrabeam_mpi.random import generator
from hydrabeam_mpi.sampling.begin import begin, first_state
from hydrabeam_mpi.sampling.state import Chance
from hydrabeam_mpi.sampling.sweep import sweep
from hydrabeam_mpi.sampling.walk import Walk
from tests.sampling.small import FLUX, drawn_from_prior, model_of, observe, small_job, walk_about_prior

FALSE_ALARM = 1e-3
"""Probability that right chains fail a case, were their seed another one."""
WIDTH = 0.5
ONE_SOURCE = {**FLUX, "foremost": 1, "width": 10 * WIDTH}


def log_density(walk: Walk, x: float) -> float:
    """Return ln p(d | x) p(x) by the covariance that noise and beam give all data: without normal equations."""
    share, (prior,) = walk.context.train, walk.context.problem.priors
    values = walk.unknowns.at(np.array([x]))
    seen = [model_of(walk, values, (one,)).reshape(-1) for one in np.eye(len(prior.mean))]
    columns = np.concatenate([np.real(seen), np.imag(seen)], axis=1).T
    data = share.rows.data.reshape(-1)
    variance = np.tile(0.5 / share.rows.inv_noise_var.reshape(-1), 2)
    covariance = np.diag(variance) + (columns * prior.std() ** 2) @ columns.T
    told = multivariate_normal.logpdf(np.concatenate([data.real, data.imag]), columns @ prior.mean, covariance)
    return float(told) - 0.5 * (x / WIDTH) ** 2


@pytest.mark.parametrize("collapsed", [True, False], ids=["beam integrated out", "given the beam"])
def test_a_flux_has_the_posterior_of_quadrature(collapsed: bool, tmp_path: Path) -> None:
    """Of one source, with data that tell its flux to a third; the posterior is no Gaussian."""
    of_prior = walk_about_prior(tmp_path, small_job(ONE_SOURCE, collapsed=collapsed), 1.0)
    rng = generator(2, "data")
    observe(of_prior, drawn_from_prior(of_prior, rng), rng)
    walk = begin(of_prior.context)
    x = np.linspace(-4 * WIDTH, 4 * WIDTH, 201)
    logs = np.array([log_density(walk, one) for one in x.tolist()])
    cumulated = cumulative_trapezoid(np.exp(logs - logs.max()), x, initial=0.0)
    mean = np.trapezoid(x * np.exp(logs - logs.max()), x) / cumulated[-1]
    state, drawn = first_state(walk, 1, 0), []
    thin = 2 if collapsed else 5
    for number in range(20 + 120 * thin):
        state, _ = sweep(walk, state, Chance(1, 0, number, number < 20))
        drawn.append(float(walk.unknowns.vector(state.values)[0]))
    kept = np.array(drawn[20::thin])
    assert kept.std() < 0.8 * WIDTH, "the data tell nothing"
    told = kstest(kept, lambda at: np.interp(at, x, cumulated / cumulated[-1]))
    assert told.pvalue > 1e-3, (mean, kept.mean(), kept.std())


def test_a_beam_that_may_not_be_negative_is_drawn_from_what_rejection_leaves(tmp_path: Path) -> None:
    """With noise so large that a third of what the data allow is left; chains begin where no beam is negative."""
    of_prior = walk_about_prior(tmp_path, small_job(positive_beam="10 deg"), 1.0)
    rng = generator(4, "data")
    observe(of_prior, drawn_from_prior(of_prior, rng), rng)
    walk = begin(of_prior.context)
    assert walk.positive is not None
    state = first_state(walk, 1, 0)
    every = walk.beams_given(state).posteriors[0].draws([generator(5, number) for number in range(10000)])
    left = every[(every @ walk.positive.rows.T >= 0).all(axis=1)]
    assert 200 < len(left) < 0.5 * len(every), len(left)
    drawn = []
    for number in range(3000):
        assert walk.positive.holds(state.beams[0])
        state, _ = sweep(walk, state, Chance(1, 0, number))
        drawn.append(state.beams[0])
    pairs = list(zip(np.array(drawn[::5]).T, left.T, strict=True))
    assert min(ks_2samp(*pair).pvalue for pair in pairs) > FALSE_ALARM / len(pairs)
