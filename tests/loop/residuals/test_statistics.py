from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from hydrabeam_mpi.loop.residuals.cube import Layout
from hydrabeam_mpi.loop.residuals.statistics import first_largest, statistics
from hydrabeam_mpi.random import complex_normal, generator
from tests.loop.white import make_layout, noise, sums_of

LAYOUT = make_layout()


def p_of(layout: Layout, z: np.ndarray, n_shared: float = 0.0, used: np.ndarray | None = None) -> float:
    return float(statistics(sums_of(layout, z, used), layout, n_shared)["significance"]["p"])


def check_calibration(p: np.ndarray) -> None:
    """P-values corrected for the looks: not small more often than chance, but small now and then."""
    assert np.sum(p < 1e-3) <= stats.binom.ppf(0.999, len(p), 1e-3)
    assert np.sum(p < 0.1) <= stats.binom.ppf(0.999, len(p), 0.1)
    assert np.sum(p < 0.5) >= len(p) * 0.1


def test_of_two_that_are_alike_the_first_is_named_however_sums_are_rounded() -> None:
    for rounding in (-1e-9, 0.0, 1e-9):
        assert first_largest(np.array([1.0, 3.0, 3.0 + rounding, 2.0])) == 1
    assert first_largest(np.array([1.0, 3.0, 3.001])) == 2
    assert first_largest(np.array([-2.0, -1.0])) == 1
    assert first_largest(np.zeros(3)) == 0


@pytest.mark.parametrize("hexagon", [(2, 3), (1, 3)])
@pytest.mark.parametrize("flagged", [0.0, 0.2])
def test_noise_is_not_significant(flagged: float, hexagon: tuple[int, int]) -> None:
    layout = make_layout(hexagon=hexagon)
    used = [generator(seed, "flags").random(layout.shape) >= flagged for seed in range(200)]
    check_calibration(np.array([p_of(layout, noise(layout, seed), used=used[seed]) for seed in range(200)]))


def smooth_columns(layout: Layout, n_times: int, n_params: int) -> np.ndarray:
    """Columns of a model that redundant baselines share and that is smooth in time, (Nfreqs Ntimes Nbls, n_params)."""
    rng = generator(3, "columns")
    n_freqs = layout.shape[0]
    rates = rng.uniform(-6, 6, (n_params, layout.redundant.Ngroups))
    phases = np.exp(2j * np.pi * rates[..., np.newaxis] * np.arange(n_times) / n_times)
    amplitudes = complex_normal(rng, (n_params, n_freqs, 1, 1))
    by_group = amplitudes * np.swapaxes(phases, 1, 2)[:, np.newaxis]
    columns = by_group[..., layout.redundant.group]
    return np.moveaxis(columns.reshape(n_params, -1), 0, 1)


@pytest.mark.parametrize("n_params", [40, 300])
def test_fitted_parameters_are_not_mistaken_for_structure(n_params: int) -> None:
    n_times = 60
    layout = make_layout(n_freqs=2, n_times=n_times)
    shape = (2, n_times, layout.shape[2])
    columns = smooth_columns(layout, n_times, n_params).reshape(*shape, n_params)
    held = np.isin(np.arange(n_times), layout.times)
    train, test = columns[:, ~held].reshape(-1, n_params), columns[:, held].reshape(-1, n_params)
    covariance = np.linalg.inv((train.conj().T @ train).real)
    parts = np.concatenate([test.real, test.imag])
    variance = 1 + np.einsum("ij,jk,ik->i", parts, covariance, parts)
    n_felt = float(np.sum(1 - 1 / variance))
    assert n_felt > 0.3 * n_params
    p = []
    for seed in range(200):
        rng = generator(seed, "fitted")
        error = covariance @ (train.conj().T @ (np.sqrt(2) * complex_normal(rng, (len(train),)))).real
        residual = np.sqrt(2) * complex_normal(rng, (len(test),)) - test @ error
        z = np.concatenate([residual.real, residual.imag]) / np.sqrt(variance)
        p.append(p_of(layout, (z[: len(test)] + 1j * z[len(test) :]).reshape(layout.shape), n_felt))
    assert np.sum(np.array(p) < 1e-3) <= 2
    assert np.sum(np.array(p) < 0.1) <= stats.binom.ppf(0.999, 200, 0.1)


def test_numbers_of_noise() -> None:
    found = statistics(sums_of(LAYOUT, noise(LAYOUT)), LAYOUT)
    assert found["overall"]["n"] == np.prod(LAYOUT.shape)
    assert found["overall"]["chi2"] == pytest.approx(1.0, abs=4 / np.sqrt(found["overall"]["n"]))
    assert set(found["axes"]) == {
        "antennas", "baselines", "groups", "lengths", "directions",
        "times", "lsts", "freqs", "fringe_rates", "delays",
    }  # fmt: skip
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    antennas = found["axes"]["antennas"]
    assert [entry["what"] for entry in antennas] == LAYOUT.observation.antenna_numbers.tolist()
    assert sum(entry["n"] for entry in antennas) == 2 * found["overall"]["n"]
    for name in set(found["axes"]) - {"antennas", "fringe_rates", "delays"}:
        assert sum(entry["n"] for entry in found["axes"][name]) == found["overall"]["n"], name


def test_an_excess_beyond_any_probability() -> None:
    z = noise(LAYOUT)
    z[:, 3] *= 1e6
    found = statistics(sums_of(LAYOUT, z), LAYOUT)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["significance"]["p"] == 0.0
    assert found["significance"]["log10_p"] < -1000


def test_a_global_excess_is_seen_before_it_is_seen_anywhere() -> None:
    z = noise(LAYOUT) * 1.08
    found = statistics(sums_of(LAYOUT, z), LAYOUT)
    assert found["significance"]["axis"] == "overall"
    assert found["significance"]["p"] < 1e-3


def test_redundant_error_and_broken_redundancy() -> None:
    n_groups = LAYOUT.redundant.Ngroups
    common = noise(LAYOUT, 7)[:, :, :n_groups][..., LAYOUT.redundant.group]
    shared = statistics(sums_of(LAYOUT, noise(LAYOUT) + 0.7 * common), LAYOUT)
    broken = statistics(sums_of(LAYOUT, noise(LAYOUT) + 0.7 * noise(LAYOUT, 8)), LAYOUT)
    assert shared["redundancy"]["common"]["sigma"] > 10
    assert abs(shared["redundancy"]["scatter"]["sigma"]) < 4
    assert shared["correlations"][0]["correlation"] == pytest.approx(0.49 / 1.49, abs=0.05)
    assert broken["redundancy"]["scatter"]["sigma"] > 10
    assert abs(broken["correlations"][0]["sigma"]) < 4


@pytest.mark.parametrize("axis", [0, 1])
def test_neighbours(axis: int) -> None:
    z, other = noise(LAYOUT), noise(LAYOUT, 9)
    smooth = (z + np.roll(z, 1, axis=axis)) / np.sqrt(2)
    found = {entry["what"]: entry for entry in statistics(sums_of(LAYOUT, smooth), LAYOUT)["correlations"]}
    names = ["neighbouring channels", "neighbouring times"]
    assert found[names[axis]]["correlation"] == pytest.approx(0.5, abs=0.06)
    assert found[names[axis]]["sigma"] > 10
    assert abs(found[names[1 - axis]]["sigma"]) < 4
    assert abs(statistics(sums_of(LAYOUT, other), LAYOUT)["correlations"][1 + axis]["sigma"]) < 4


def test_one_outlier() -> None:
    z = noise(LAYOUT)
    z[2, 5, 11] = 9.0
    found = statistics(sums_of(LAYOUT, z), LAYOUT)
    largest = found["tails"]["largest"]
    observation = LAYOUT.observation
    assert largest["z"] == pytest.approx(9.0)
    assert largest["baseline"] == observation.antpairs[11].tolist()
    assert largest["jd"] == observation.times[LAYOUT.times[5]]
    assert largest["freq_hz"] == observation.freqs[2]
    assert largest["corrected_sigma"] > 5
    assert found["significance"]["axis"] in ("largest", "kurtosis")
    assert found["significance"]["p"] < 1e-3


def test_one_time_and_one_channel() -> None:
    layout = make_layout(n_freqs=1, n_times=3)
    found = statistics(sums_of(layout, noise(layout)), layout)
    assert not {"fringe_rates", "delays"} & set(found["axes"])
    assert found["significance"]["p"] > 1e-3


def test_nothing_held_out() -> None:
    found = statistics(sums_of(LAYOUT, noise(LAYOUT), np.zeros(LAYOUT.shape, dtype=bool)), LAYOUT)
    assert found["overall"]["n"] == 0
    assert found["significance"]["p"] == 1.0


def test_fast_fringes_are_aliased() -> None:
    wide = statistics(sums_of(LAYOUT, noise(LAYOUT)), LAYOUT)["fringe_rates_aliased"]
    short = make_layout(n_times=3000, every=300)
    dense = Layout(short.observation, short.redundant, np.arange(100, 120))
    assert wide
    assert not statistics(sums_of(dense, noise(dense)), dense)["fringe_rates_aliased"]
