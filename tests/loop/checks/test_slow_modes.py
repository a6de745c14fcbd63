"""Series that lack noise in their slow modes are told from all that hold it, whatever the sky and the flags."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.signal.windows import dpss
from scipy.stats import binom, kstest

from hydrabeam_mpi.inference.robust import ABSURD_P
from hydrabeam_mpi.loop.checks.slow_modes import LEAST_NOISE, ORDERS, Series, lacking_modes

N_TIMES, N_SERIES = 40, 60
TIMES = np.arange(N_TIMES) * 10.0


def gaussian(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Complex noise of unit variance."""
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def sky_of(rng: np.random.Generator, amplitude: float = 100.0, n_series: int = N_SERIES) -> np.ndarray:
    """Fringes of up to five turns, (Ntimes, Nseries)."""
    rates = rng.uniform(-5, 5, size=(20, n_series)) / N_TIMES
    phases = 2 * np.pi * (rates[:, np.newaxis] * np.arange(N_TIMES)[:, np.newaxis] + rng.random((20, 1, n_series)))
    return amplitude * np.exp(1j * phases).sum(axis=0) / np.sqrt(20)


def flagged(rng: np.random.Generator, share: float, n_series: int = N_SERIES) -> np.ndarray:
    """Inverse variances that differ from series to series and by a tenth in time, zero for a share of the samples."""
    weights = rng.uniform(0.5, 2.0, n_series) * (1 + 0.1 * np.sin(np.arange(N_TIMES) / 9))[:, np.newaxis]
    return np.where(rng.random((N_TIMES, n_series)) < share, 0.0, weights)


def without(modes: np.ndarray, data: np.ndarray, weights: np.ndarray, *, by_weight: bool = False) -> np.ndarray:
    """Subtract the modes (Ntimes, K) as they fit each series' unflagged samples best."""
    left = data.copy()
    for b, one in enumerate(weights.T):
        root = np.sqrt(one if by_weight else (one > 0).astype(float))
        fit = np.linalg.lstsq(root[:, np.newaxis] * modes, root * data[:, b], rcond=None)[0]
        left[:, b] -= modes @ fit
    return left


def look(data: np.ndarray, model: np.ndarray, weights: np.ndarray, level: float = 1.0, **changes: Any) -> Any:
    return lacking_modes(MPI.COMM_SELF, [Series.of(TIMES, data, model, weights)], level, **changes)


FILTERS = {
    "mean": np.ones((N_TIMES, 1)),
    "line": np.stack([np.ones(N_TIMES), TIMES], axis=1),
    "notch": dpss(N_TIMES, 1.3, 3).T,
    "wide notch": dpss(N_TIMES, 2.2, 5).T,
}


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("share", [0.0, 0.2])
def test_what_a_filter_took_is_counted(name: str, share: float) -> None:
    rng, modes = np.random.default_rng(1), FILTERS[name]
    weights, sky = flagged(rng, share), sky_of(rng)
    data = sky + np.where(weights > 0, gaussian(rng, *sky.shape) / np.sqrt(np.maximum(weights, 0.1)), 1e6)
    assert look(data, sky, weights) is None
    found = look(without(modes, data, weights), 1.2 * sky, weights)
    assert found.n_modes == modes.shape[1]
    assert found.power < 0.01
    assert found.model > 1000
    assert (found.among == 1) == (name == "mean")


def test_a_mean_by_weights_is_found_with_weights() -> None:
    rng = np.random.default_rng(1)
    sky = sky_of(rng, 1e4)
    weights = rng.uniform(0.5, 2.0, sky.shape)
    data = without(FILTERS["mean"], sky + gaussian(rng, *sky.shape) / np.sqrt(weights), weights, by_weight=True)
    assert look(data, sky, weights) is None
    weighted = Series.of(TIMES, data, sky, weights).weighted()
    assert lacking_modes(MPI.COMM_SELF, [weighted], 1.0).among == 1


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_noise_alone_is_not_lacking(share: float) -> None:
    """Though the model promises power in all modes: the bound on the probability holds with few series and many."""
    rng = np.random.default_rng(2)
    for n_series in (4, 12, 60):
        n_found = np.zeros(2)
        for _ in range(60):
            weights, model = flagged(rng, share, n_series), sky_of(rng, n_series=n_series)
            noise = gaussian(rng, *model.shape) / np.sqrt(np.maximum(weights, 0.1))
            n_found += [look(noise, model, weights, chance=chance) is not None for chance in (0.05, ABSURD_P)]
        most = binom.ppf(0.999, 60, 0.05 * sum(2 * k <= n_series for k in ORDERS if 2 * k <= N_TIMES))
        assert n_found[0] <= most
        assert n_found[1] == 0


def test_the_probability_of_one_mode_is_exact() -> None:
    """Of noise alone it is uniform."""
    rng = np.random.default_rng(3)
    model = np.full((3, 10), 100.0 + 0j)
    weights = np.ones(model.shape)
    looks = [Series.of(TIMES[:3], gaussian(rng, 3, 10), model, weights) for _ in range(300)]
    chances = [lacking_modes(MPI.COMM_SELF, [one], 1 / LEAST_NOISE[0], chance=2.0).chance for one in looks]
    assert kstest(chances, "uniform").pvalue > 0.01


def test_nights_of_unequal_length_count_as_far_as_they_go() -> None:
    rng = np.random.default_rng(4)
    weights, sky = np.ones((N_TIMES, N_SERIES)), sky_of(rng)
    left = without(FILTERS["notch"], sky + gaussian(rng, *sky.shape), weights)
    short = Series.of(TIMES[:5], left[:5] - left[:5].mean(axis=0), sky[:5], weights[:5])
    found = lacking_modes(MPI.COMM_SELF, [short, Series.of(TIMES, left, sky, weights)], 1.0)
    assert found is not None
    assert found.n_modes == 3


def test_nothing_is_looked_at_where_there_is_nothing() -> None:
    nothing = np.zeros((N_TIMES, 0))
    assert look(nothing + 0j, nothing + 0j, nothing) is None
    flagged_out = np.zeros((N_TIMES, 3))
    assert look(flagged_out + 0j, flagged_out + 0j, flagged_out) is None
    single = np.ones((1, N_SERIES))
    assert lacking_modes(MPI.COMM_SELF, [Series.of(TIMES[:1], single + 0j, 100 * single + 0j, single)], 1.0) is None
    assert lacking_modes(MPI.COMM_SELF, [], 1.0) is None
