"""Chains of channels that hang together draw from the joint posterior of all of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.stats import kstest, multivariate_normal

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.over_frequency import squared_exponential
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.sampling.begin import begin, first_state
from hydrabeam_mpi.sampling.state import Chance
from hydrabeam_mpi.sampling.sweep import sweep
from hydrabeam_mpi.sampling.walk import Walk
from tests.loop.mock import context_of
from tests.sampling.small import FLUX, drawn_from_prior, model_of, observe, small_job, walk_about_prior

WIDTH, LENGTH = 0.5, 10e6
SOURCE = {**FLUX, "foremost": 1, "width": 10 * WIDTH}


def coupled_job(**sample: Any) -> dict[str, Any]:
    """Two channels, 8 MHz apart."""
    job = small_job(SOURCE, n_freqs=2, **sample)
    return {**job, "prior": {"frequency": {"kind": "gaussian-process", "length": LENGTH}}}


def dense(walk: Walk, x: float) -> tuple[float, np.ndarray]:
    """Return ln p(d | x) p(x), and the mean of the coefficients of both beams, by the covariance of all data."""
    share, priors = walk.context.train, walk.context.problem.priors
    values = walk.unknowns.at(np.array([x]))
    n, means, widths = len(priors[0].mean), [one.mean for one in priors], [one.std() for one in priors]
    columns = []
    for one in np.eye(2 * n):
        seen = model_of(walk, values, (one[:n], one[n:])).reshape(-1)
        columns.append(np.concatenate([seen.real, seen.imag]))
    design, mean, width = np.array(columns).T, np.concatenate(means), np.concatenate(widths)
    over = squared_exponential(walk.context.setup.observation.freqs, LENGTH)
    spread = np.kron(over, np.eye(n)) * np.outer(width, width)
    data = share.rows.data.reshape(-1)
    noise = np.diag(np.tile(0.5 / share.rows.inv_noise_var.reshape(-1), 2))
    covariance = noise + design @ spread @ design.T
    parts = np.concatenate([data.real, data.imag])
    told = multivariate_normal.logpdf(parts, design @ mean, covariance)
    beams = mean + spread @ design.T @ np.linalg.solve(covariance, parts - design @ mean)
    return float(told) - 0.5 * (x / WIDTH) ** 2, beams


def test_a_flux_and_beams_have_the_posterior_of_quadrature(tmp_path: Path) -> None:
    of_prior = walk_about_prior(tmp_path, coupled_job(), 1.5)
    rng = generator(2, "data")
    observe(of_prior, drawn_from_prior(of_prior, rng), rng)
    walk = begin(of_prior.context)
    assert walk.unknowns.size == 1
    x = np.linspace(-4 * WIDTH, 4 * WIDTH, 101)
    logs, beams = zip(*(dense(walk, one) for one in x.tolist()), strict=True)
    density = np.exp(np.array(logs) - max(logs))
    cumulated = cumulative_trapezoid(density, x, initial=0.0)
    expected = np.trapezoid(np.array(beams) * density[:, np.newaxis], x, axis=0) / cumulated[-1]
    state, drawn = first_state(walk, 1, 0), []
    for number in range(260):
        state, _ = sweep(walk, state, Chance(1, 0, number, number < 20))
        drawn.append(np.concatenate([walk.unknowns.vector(state.values), *state.beams]))
    kept = np.array(drawn[20::2])
    assert kept[:, 0].std() < 0.8 * WIDTH, "the data tell nothing"
    assert kstest(kept[:, 0], lambda at: np.interp(at, x, cumulated / cumulated[-1])).pvalue > 1e-3
    away = (kept[:, 1:].mean(axis=0) - expected) / kept[:, 1:].std(axis=0)
    assert np.all(np.abs(away) < 4.5 / np.sqrt(len(kept)))
    # Both channels' first coefficients move together.
    n = len(state.beams[0])
    assert np.corrcoef(kept[:, 1], kept[:, 1 + n])[0, 1] > 0.2


@pytest.mark.parametrize(
    ("sample", "words"), [({"blocks": ("prior_width",)}, "prior_width"), ({"positive_beam": 5.0}, "positive_beam")]
)
def test_what_is_of_single_channels_is_refused(sample: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"{words} does not go with beams that hang together"):
        begin(context_of(coupled_job(**sample), tmp_path))
