"""Changes of the weights, from the residuals of fitted rows on all ranks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.effects.noise.noise_level import NoiseLevel
from hydrabeam_mpi.effects.noise.outliers import HIT, Outliers
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Fitted, Reweighted, Values
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.loop.attribution.score_noise import (
    HeavyTails,
    _variance,
    fit_reweightings,
    looked_for_again,
    refit_reweighting,
)
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup
from tests.loop.mock import context_of, mock_job

NOISE = {"kind": "noise_level", "parameters": {"noise scale": 2.0}}
BURSTS = {"kind": "outliers", "parameters": {"fraction of rows hit": 0.03, "scale of |z|^2 where hit": 1e5}}


def fitted(folder: Path, world: MPI.Comm, *injected: dict[str, Any], **changes: Any) -> tuple[FitContext, Fitted]:
    context = context_of(mock_job(*injected, n_times=30, **changes), folder, world)
    return context, refit(context, Values())


FOUND: list[Any] = [
    pytest.param([], NoiseLevel(), None, id="noise as it should be has the scale one"),
    pytest.param([NOISE], NoiseLevel(), 2.0, id="noise twice as large has the scale two"),
]


@pytest.mark.mpi
@pytest.mark.parametrize(("injected", "change", "scale"), FOUND)
def test_the_level_of_the_noise(
    injected: list[dict[str, Any]], change: Reweighting, scale: float | None, comm: MPI.Comm, common_tmp_path: Path
) -> None:
    context, before = fitted(common_tmp_path, comm, *injected)
    (found,) = fit_reweightings(context, before, [change])
    assert found.change is change
    assert found.start is not None
    assert found.fit.reason is None
    assert found.fit.names == ("noise scale",)
    (x,), (std,) = found.fit.x[:, 0], found.fit.std[:, 0]
    assert abs(x - (scale or 1.0)) < 4 * std
    assert (found.fit.log_bayes_factor > 20) == (scale is not None)
    # Fitted again with these weights, and with what the beam has taken of each baseline, it is much the same.
    weighted = refit(context, Values(reweighted=(Reweighted(change, found.fit.x, found.fit.std),)), before)
    again = refit_reweighting(context, weighted, change)
    assert abs(float(again.x[0, 0]) - (scale or 1.0)) < 4 * std
    assert abs(float(again.x[0, 0]) - x) < std


@pytest.mark.mpi
def test_strong_bursts_are_found_once_rows_far_out_count_less(comm: MPI.Comm, common_tmp_path: Path) -> None:
    """They pull the plain fit so far that all rows seem to be outliers; the fit that has told is another one."""
    context, before = fitted(common_tmp_path, comm, BURSTS)
    noise, bursts = looked_for_again(context, before, fit_reweightings(context, before, [NoiseLevel(), Outliers()]))
    assert noise.fit.reason is not None
    assert noise.start is before
    assert bursts.fit.reason is None
    assert bursts.fit.log_bayes_factor > 100
    assert bursts.start is not before
    assert bursts.start.values.reweighted == ()
    assert abs(float(bursts.fit.x[0, 1]) - 0.03) < 4 * float(bursts.fit.std[0, 1])


def test_rows_count_the_less_the_further_off_they_are() -> None:
    """By the weights with which the maximum of a Student t likelihood is found, whose derivative they have."""
    block = small_block(small_setup(n_times=4))
    block = replace(block, residual=complex_normal(generator(1, "tails"), block.shape) * np.geomspace(1e-3, 1e3, 21))
    block = replace(block, weights=generator(2, "tails").uniform(0.5, 2, block.shape))
    block.weights[2, 4] = 0.0
    factor = HeavyTails().weight_factor(block, np.zeros(0))
    u = np.abs(block.residual) ** 2 * block.weights

    def log_density(u: np.ndarray) -> np.ndarray:
        """Of complex t with one degree of freedom, (1 + 2 u)^-(1 + 2)/2."""
        return -1.5 * np.log1p(2 * u)

    step = 1e-6 * (1 + u)
    slope = (log_density(u + step) - log_density(np.maximum(u - step, 0))) / (u + step - np.maximum(u - step, 0))
    np.testing.assert_allclose(factor, -slope, rtol=1e-4)  # that of Gaussian noise is one everywhere
    assert factor.max() <= 3
    assert factor[u > HIT].max() < 0.06


@pytest.mark.parametrize("is_complex", [False, True], ids=["real coefficients", "complex coefficients"])
def test_what_the_beam_is_uncertain_of_a_prediction(is_complex: bool) -> None:
    """The mean of |a (b - mean)|^2 over draws."""
    rng = generator(4, "variance", int(is_complex))
    rows = complex_normal(rng, (2, 3, 4))
    factor = np.tril(complex_normal(rng, (4, 4)) if is_complex else rng.standard_normal((4, 4)))
    factor[np.diag_indices(4)] = rng.uniform(1, 2, 4)
    posterior = Posterior(np.zeros(4, dtype=factor.dtype), factor)
    design = rows if is_complex else np.stack([rows.real, rows.imag], axis=1)
    draws = np.array([posterior.draw(rng) for _ in range(20000)])
    expected = np.mean(np.abs(rows @ draws.T) ** 2, axis=-1)
    np.testing.assert_allclose(_variance(posterior, design), expected, rtol=0.05)
