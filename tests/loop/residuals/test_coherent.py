"""What residuals have in common with the model."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy import stats

from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.loop.residuals.coherent import (
    CHANGES,
    CONSTANTS,
    FACTORS,
    GAINS,
    CoherentRows,
    CoherentSums,
    coherences,
)
from hydrabeam_mpi.loop.residuals.localise import where
from hydrabeam_mpi.loop.residuals.statistics import statistics
from hydrabeam_mpi.random import complex_normal, generator
from tests.loop.white import make_layout, noise, sums_of

LAYOUT = make_layout(n_freqs=2)
NT, NBLS = LAYOUT.shape[1:]
SHAPE = (2, LAYOUT.observation.Ntimes, NBLS)


def rows_of() -> CoherentRows:
    flipped = LAYOUT.redundant.flipped[:, np.newaxis]
    antennas = np.where(flipped, LAYOUT.observation.antenna_index[:, ::-1], LAYOUT.observation.antenna_index)
    return CoherentRows(np.arange(NBLS), antennas, LAYOUT.redundant.group)


def model() -> np.ndarray:
    """The model, whitened: what redundant baselines share, at each baseline's own noise."""
    rng = generator(4, "model")
    by_group = 50 * complex_normal(rng, (2, SHAPE[1], LAYOUT.redundant.Ngroups))
    return by_group[..., LAYOUT.redundant.group] * rng.uniform(0.5, 2, NBLS)


def white(seed: int) -> np.ndarray:
    return np.sqrt(2) * complex_normal(generator(seed, "coherent"), SHAPE)


def looks_of(z: np.ndarray, m: np.ndarray, used: np.ndarray | None = None, comm: MPI.Comm = MPI.COMM_SELF) -> dict:
    used = np.ones(SHAPE, dtype=bool) if used is None else used
    times = np.array_split(np.arange(SHAPE[1]), comm.size)[comm.rank]
    sums = CoherentSums.zeros(2, LAYOUT.observation.Nants, SHAPE[1], NBLS)
    for f in range(2):
        sums.add(f, times, np.where(used, z, 0)[f, times], np.where(used, m, 0)[f, times], rows_of())
    return {one.name: one for one in coherences(sums.reduce(comm))}


def with_gains(m: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Return what gains, (Nfreqs, Ntimes, Nants), add to the residual."""
    one, two = rows_of().antennas.T
    return m * (gains[..., one] * gains[..., two].conj() - 1)


def test_noise_follows_nothing() -> None:
    """Chi^2 of every look has its distribution, flags or not, whatever redundant baselines share."""
    common = 3 * model()  # beam and sky may be wrong by any amount
    values: dict[str, list[float]] = {}
    for seed in range(60):
        used = generator(seed, "used").random(SHAPE) > 0.2
        for name, one in looks_of(white(seed) + common, model(), used).items():
            values.setdefault(name, []).extend(stats.chi2.cdf(one.chi2, one.dof)[:: max(1, len(one.dof) // 5)])
    assert values.keys() == {GAINS, CHANGES, FACTORS, CONSTANTS}
    for name, p in values.items():
        assert stats.kstest(p, "uniform").pvalue > 1e-3, name


def test_a_gain_is_found_with_its_size() -> None:
    gains = np.ones((2, SHAPE[1], 7), dtype=complex)
    gains[:, :, 2] = np.exp(0.004 - 0.003j)
    m = model()
    one = looks_of(with_gains(m, gains), m)[GAINS]
    assert one.index[np.argmax(one.chi2)] == 2
    # Chi^2 is the change that no common factor of each group makes.
    change = with_gains(m, gains)
    group = LAYOUT.redundant.group
    left = change.copy()
    for g in range(group.max() + 1):
        mine = group == g
        factor = np.sum(m[..., mine].conj() * change[..., mine], axis=-1) / np.sum(np.abs(m[..., mine]) ** 2, axis=-1)
        left[..., mine] -= m[..., mine] * factor[..., np.newaxis]
    assert one.chi2.max() == pytest.approx(np.sum(np.abs(left) ** 2), rel=0.02)


def test_a_gain_that_jumps_is_found_with_its_time() -> None:
    gains = np.ones((2, SHAPE[1], 7), dtype=complex)
    gains[:, 40:, 5] += 0.01j
    found = looks_of(white(1) + with_gains(model(), gains), model())[CHANGES]
    best = np.argmax(found.chi2)
    assert found.index[best] == 5
    assert abs(found.after[best] - 39) <= 2
    assert found.sigma()[best] > 5


def test_the_place_is_told_where_chi2_tells_none() -> None:
    gains = np.ones((2, SHAPE[1], 7), dtype=complex)
    gains[:, :30, 5] -= 0.01
    gains[:, 30:, 5] += 0.01
    looks = tuple(looks_of(white(1) + with_gains(model(), gains), model()).values())
    sums = sums_of(LAYOUT, noise(LAYOUT))
    assert where(sums, LAYOUT)["antennas"]["state"] == "even"
    told = where(sums, LAYOUT, 0.0, looks)
    assert told["antennas"]["state"] == "concentrated"
    number = int(LAYOUT.observation.antenna_numbers[5])
    assert told["antennas"]["entries"][0]["what"] == number
    assert f"antenna {number} after LST" in told["sentence"]
    assert statistics(sums, LAYOUT)["significance"]["p"] > 0.01
    assert statistics(sums, LAYOUT, 0.0, looks)["significance"]["p"] < 1e-6


def test_noise_that_grows_is_of_no_antenna() -> None:
    """What is larger at some times has more in common with anything then."""
    growth = np.where(np.arange(SHAPE[1]) < 2 * SHAPE[1] // 3, 1.0, 4.0)[:, np.newaxis]
    for seed in range(5):
        z = growth * white(seed)
        told = where(sums_of(LAYOUT, z[:, LAYOUT.times]), LAYOUT, 0.0, tuple(looks_of(z, model()).values()))
        assert told["times"]["state"] != "even"
        assert told["antennas"]["state"] == told["baselines"]["state"] == "even"


@pytest.mark.parametrize(("kind", "amount"), [(FACTORS, 0.01), (CONSTANTS, 1.5j)])
def test_a_baseline_is_found(kind: str, amount: complex) -> None:
    z = white(2)
    z[..., 8] += amount * model()[..., 8] if kind == FACTORS else amount
    found = looks_of(z, model())[kind]
    assert found.index[np.argmax(found.chi2)] == 8
    assert found.sigma().max() > 5


def test_without_redundant_baselines_there_is_nothing_to_see() -> None:
    alone = find_redundant_groups(generator(1, "vectors").standard_normal((5, 3)), 1e-6)
    sums = CoherentSums.zeros(1, 4, 3, 5)
    rows = CoherentRows(np.arange(5), np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3]]), alone.group)
    sums.add(0, np.arange(3), white(0)[0, :3, :5], model()[0, :3, :5], rows)
    assert list(coherences(sums)) == []


@pytest.mark.mpi
def test_ranks_agree(comm: MPI.Comm) -> None:
    z, m = white(3), model()
    for name, one in looks_of(z, m).items():
        np.testing.assert_allclose(looks_of(z, m, comm=comm)[name].chi2, one.chi2, rtol=1e-9)
