from __future__ import annotations

import itertools
from dataclasses import fields

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.loop.residuals.cube import whole_baselines
from hydrabeam_mpi.loop.residuals.statistics import statistics
from hydrabeam_mpi.loop.residuals.structures import decompose
from hydrabeam_mpi.loop.residuals.sums import ResidualSums
from hydrabeam_mpi.random import generator
from tests.loop.white import make_layout, noise, share_of, sums_of


def test_sums_are_what_loops_give() -> None:
    layout = make_layout(n_freqs=3, n_times=15)
    z, used = noise(layout), generator(1, "used").random(layout.shape) < 0.8
    found = sums_of(layout, z, used)
    z = z.astype(np.complex64).astype(complex)
    power = np.where(used, np.abs(z) ** 2, 0.0)

    np.testing.assert_allclose(found.by_baseline, [used.sum(axis=(0, 1)), power.sum(axis=(0, 1))])
    np.testing.assert_allclose(found.by_time, [used.sum(axis=(0, 2)), power.sum(axis=(0, 2))])
    np.testing.assert_allclose(found.by_channel, [used.sum(axis=(1, 2)), power.sum(axis=(1, 2))])
    np.testing.assert_allclose(found.quartic, np.sum(power**2))
    largest = np.unravel_index(np.argmax(power), power.shape)
    f, t, b = (int(i) for i in largest)
    assert found.largest == (pytest.approx(power[largest]), f, layout.times[t], b)

    group = layout.redundant.group
    within, times, channels = np.zeros(3), np.zeros(3), np.zeros(3)
    for f, t, b in itertools.product(*map(range, z.shape)):
        others = [(within, (f, t, c)) for c in range(b + 1, z.shape[2]) if group[c] == group[b]]
        others += [(times, (f, t + 1, b))] if t + 1 < z.shape[1] else []
        others += [(channels, (f + 1, t, b))] if f + 1 < z.shape[0] else []
        for sums, other in others:
            if used[f, t, b] and used[other]:
                product = z[f, t, b] * z[other].conj()
                sums += [1, product.real, 0.5 * (power[f, t, b] + power[other])]
    np.testing.assert_allclose(found.pairs, [within, times, channels], rtol=1e-9)

    common = np.zeros(4)
    for f, t, g in itertools.product(range(z.shape[0]), range(z.shape[1]), range(group.max() + 1)):
        members = z[f, t, (group == g) & used[f, t]]
        if len(members) > 1:
            common += [1, abs(members.sum()) ** 2 / len(members), len(members), np.sum(np.abs(members) ** 2)]
    np.testing.assert_allclose(found.common, common, rtol=1e-9)


def test_spectra_hold_all_the_power() -> None:
    layout = make_layout()
    found = sums_of(layout, noise(layout))
    n_freqs, n_times, n_bls = layout.shape
    np.testing.assert_array_equal(found.by_fringe_rate[0], n_freqs * n_bls)
    np.testing.assert_array_equal(found.by_delay[0], n_times * n_bls)
    np.testing.assert_allclose(found.by_fringe_rate[1].sum(), found.chi2, rtol=1e-5)
    np.testing.assert_allclose(found.by_delay[1].sum(), found.chi2, rtol=1e-5)


@pytest.mark.mpi
@pytest.mark.parametrize("n_groups", [1, 2, 3])
@pytest.mark.parametrize("max_bytes", [2**26, 1000])
def test_ranks_agree(comm: MPI.Comm, n_groups: int, max_bytes: int) -> None:
    layout = make_layout(n_freqs=4, n_times=24)
    z, used = noise(layout), generator(1, "used").random(layout.shape) < 0.8
    z[:, :, 4] += 3.0
    alone = sums_of(layout, z, used)
    cube = whole_baselines(comm, share_of(comm, layout, z, used, n_groups), layout, max_bytes)
    together = ResidualSums.of(cube).reduce(comm)
    for field in fields(ResidualSums):
        one, other = getattr(together, field.name), getattr(alone, field.name)
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6, err_msg=field.name)
    one, other = statistics(together, layout)["significance"], statistics(alone, layout)["significance"]
    assert (one["axis"], one["what"]) == (other["axis"], other["what"])
    assert one["log10_p"] == pytest.approx(other["log10_p"], rel=1e-5)


@pytest.mark.mpi
def test_more_ranks_than_times(comm: MPI.Comm) -> None:
    layout = make_layout(n_freqs=1, n_times=4)
    z, used = noise(layout), np.ones(layout.shape, dtype=bool)
    together = ResidualSums.of(whole_baselines(comm, share_of(comm, layout, z, used, 1), layout)).reduce(comm)
    np.testing.assert_allclose(together.by_baseline, sums_of(layout, z).by_baseline, rtol=1e-6)


@pytest.mark.mpi
def test_singular_values_on_ranks(comm: MPI.Comm) -> None:
    layout = make_layout(n_freqs=2, n_times=24)
    z, used = noise(layout), np.ones(layout.shape, dtype=bool)
    z += 4 * noise(layout, 5)[:, :, :1] * noise(layout, 6)[:1, :1]
    found = decompose(comm, whole_baselines(comm, share_of(comm, layout, z, used, 2), layout))
    left, values, right = np.linalg.svd(z.reshape(-1, layout.shape[2]).T, full_matrices=False)
    np.testing.assert_allclose(found.values[0], values[0], rtol=1e-5)
    np.testing.assert_allclose(found.by_baseline[0], np.abs(left[:, 0]) ** 2, atol=1e-5)
    overlap = np.vdot(right[0], found.patterns[0].ravel())
    assert abs(overlap) == pytest.approx(1.0, abs=1e-5)
