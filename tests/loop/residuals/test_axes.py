"""Chi^2 along the axes of the data, against sums over single visibilities."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.inference.significance import chi2_sigma
from hydrabeam_mpi.loop.residuals.axes import MAX_LENGTHS, Axis, Freedom, all_axes, length_bins
from hydrabeam_mpi.loop.residuals.cube import Layout
from hydrabeam_mpi.random import generator
from tests.loop.white import make_layout, noise, sums_of

LAYOUT = make_layout(n_freqs=4, n_times=30)


def flagged(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Residuals in single precision, as they are summed, and which there are: none of one antenna and of one time."""
    used = generator(1, "axes").random(layout.shape) < 0.8
    used[:, 3] = False
    used[..., np.any(layout.observation.antenna_index == 2, axis=1)] = False
    return noise(layout).astype(np.complex64).astype(complex), used


def by_hand(layout: Layout, z: np.ndarray, used: np.ndarray, name: str) -> dict[object, list[float]]:
    """Add up number and power of single visibilities by what an axis says of them."""
    observation, redundant = layout.observation, layout.redundant
    vectors = redundant.vectors[redundant.group]
    # Degrees from East through North, of a vector in either sense.
    degrees = np.round(np.rad2deg(np.arctan2(vectors[:, 1], vectors[:, 0])) / 15) * 15
    found: dict[object, list[float]] = {}
    for f, t, b in itertools.product(*map(range, z.shape)):
        jd, lst = (float(values[layout.times[t]]) for values in (observation.times, observation.lsts))
        hours = lst * 12 / np.pi % 24
        keys: dict[str, list[object]] = {
            "antennas": observation.antpairs[b].tolist(),
            "baselines": [tuple(observation.antpairs[b].tolist())],
            "groups": [int(redundant.group[b])],
            "lengths": [round(float(np.linalg.norm(vectors[b])), 3)],
            "directions": [float((degrees[b] + 90) % 180 - 90)],
            "times": [(jd, round(hours, 5))],
            "lsts": [np.floor(2 * hours) / 2 + 0.25],
            "freqs": [float(observation.freqs[f])],
        }
        for key in keys[name]:
            if used[f, t, b]:
                sums = found.setdefault(key, [0.0, 0.0])
                sums[0] += 1
                sums[1] += abs(z[f, t, b]) ** 2
    return found


def key_of(name: str, what: object) -> object:
    if name == "baselines":
        return tuple(what)
    return (what["jd"], what["lst_h"]) if name == "times" else what


@pytest.mark.parametrize("name", ["antennas", "baselines", "groups", "lengths", "directions", "times", "lsts", "freqs"])
def test_an_axis_has_the_sums_of_its_entries(name: str) -> None:
    """Those without data are left out."""
    z, used = flagged(LAYOUT)
    axis = all_axes(sums_of(LAYOUT, z, used), LAYOUT)[name]
    expected = by_hand(LAYOUT, z, used, name)
    found = {key_of(name, what): [n, power] for what, n, power in zip(axis.what, axis.n, axis.power, strict=True)}
    assert found.keys() == expected.keys()
    for key, sums in expected.items():
        assert found[key] == pytest.approx(sums, rel=1e-6), key
    n, power = np.sum(list(expected.values()), axis=0)
    assert axis.level == pytest.approx(power / (2 * n), rel=1e-6)
    np.testing.assert_allclose(axis.chi2, axis.power / (2 * axis.n))
    assert len(axis.values) == len(axis)


@pytest.mark.parametrize("name", ["fringe_rates", "delays"])
def test_spectra_are_sums_of_transforms(name: str) -> None:
    """Of samples that there are: of each spectrum with half of them, its power over their number."""
    z, used = flagged(LAYOUT)
    axis = all_axes(sums_of(LAYOUT, z, used), LAYOUT)[name]
    observation = LAYOUT.observation
    x = 86400 * observation.times[LAYOUT.times] if name == "fringe_rates" else observation.freqs
    samples = np.moveaxis(np.where(used, z, np.nan), 1 if name == "fringe_rates" else 0, 0).reshape(len(x), -1)
    there = ~np.isnan(samples.real)
    enough = 2 * there.sum(axis=0) >= len(x)
    samples, there = np.where(there, samples, 0)[:, enough], there[:, enough]
    waves = np.exp(-2j * np.pi * np.outer(np.array(axis.what), x - x[0]))
    np.testing.assert_allclose(axis.power, np.sum(np.abs(waves @ samples) ** 2 / there.sum(axis=0), axis=1), rtol=1e-4)
    np.testing.assert_array_equal(axis.n, np.full(len(x), enough.sum()))
    assert axis.spectral
    assert np.all(np.diff(axis.values) > 0)
    assert axis.oversampling == pytest.approx(np.mean(len(x) / there.sum(axis=0)), rel=1e-6)


def test_few_lengths_have_a_bin_each() -> None:
    bins, n_bins = length_bins(LAYOUT)
    lengths = np.linalg.norm(LAYOUT.redundant.vectors[LAYOUT.redundant.group], axis=1)
    for one in range(n_bins):
        np.testing.assert_allclose(lengths[bins == one], lengths[bins == one][0], atol=0.05)
    assert n_bins == len(np.unique(np.round(lengths, 1))) == 3


def test_many_lengths_are_binned_with_about_as_many_baselines_each() -> None:
    layout = make_layout(n_freqs=1, n_times=4, hexagon=(5, 6))
    vectors = generator(2, "lengths").uniform(-100, 100, layout.redundant.vectors.shape)
    layout = Layout(layout.observation, replace(layout.redundant, vectors=vectors), layout.times)
    bins, n_bins = length_bins(layout)
    lengths, group_sizes = np.linalg.norm(vectors, axis=1), np.bincount(layout.redundant.group)
    assert MAX_LENGTHS / 2 < len(np.unique(bins)) <= n_bins <= MAX_LENGTHS
    assert np.all(np.diff(bins[np.argsort(lengths[layout.redundant.group])]) >= 0)
    # But for redundant baselines, which stay together.
    assert np.bincount(bins).max() <= len(bins) / MAX_LENGTHS + group_sizes.max()


def test_directions_are_the_same_in_either_sense() -> None:
    z, used = flagged(LAYOUT)
    one = all_axes(sums_of(LAYOUT, z, used), LAYOUT)["directions"]
    redundant = LAYOUT.redundant
    turned = Layout(LAYOUT.observation, replace(redundant, vectors=-redundant.vectors), LAYOUT.times)
    two = all_axes(sums_of(turned, z, used), turned)["directions"]
    assert one.what == two.what
    np.testing.assert_allclose(one.power, two.power)


def test_nothing_has_no_axes() -> None:
    nothing = np.zeros(LAYOUT.shape, dtype=bool)
    assert all_axes(sums_of(LAYOUT, noise(LAYOUT), nothing), LAYOUT) == {}
    single = Layout(LAYOUT.observation, find_redundant_groups(LAYOUT.observation.bl_vectors, 1e-3), LAYOUT.times[:1])
    assert "fringe_rates" not in all_axes(sums_of(single, noise(single)), single)


FREEDOMS = [
    pytest.param(0.0, 100.0, 0.0, id="no parameter is felt"),
    pytest.param(20.0, 100.0, 0.1, id="one parameter in ten data"),
    pytest.param(1e4, 100.0, 1.0, id="no more than all data"),
    pytest.param(5.0, 0.0, 0.0, id="without data there is nothing to share"),
]


@pytest.mark.parametrize(("n_shared", "n", "share"), FREEDOMS)
def test_freedom(n_shared: float, n: float, share: float) -> None:
    found = Freedom.of(n_shared, n)
    assert found.share == share
    assert found.scale == 1 + share


@pytest.mark.parametrize(("scatter", "scale"), [(0.0, 1.0), (0.5, np.exp(0.5))], ids=["Gaussian", "of other sizes"])
def test_heavy_tails_scatter_more(scatter: float, scale: float) -> None:
    """The variance of |z|^2 over that of Gaussian z of as much power, with powers that scatter as e^N(0, scatter)."""
    z = noise(LAYOUT)
    z = z * np.exp(0.5 * np.sqrt(scatter) * generator(3, "tails").standard_normal(z.shape))
    assert Freedom(0.0).heavier(sums_of(LAYOUT, z)).scale == pytest.approx(scale, abs=0.1)
    assert Freedom(0.5).heavier(sums_of(LAYOUT, z)).scale == pytest.approx(1.5 * scale, abs=0.15)


def axis(chi2: FloatArray, n: float, spectral: bool = False, oversampling: float = 1.0) -> Axis:
    counts, zeros = np.full(len(chi2), n), np.zeros(len(chi2))
    return Axis("made", list(range(len(chi2))), counts, 2 * counts * chi2, [], zeros, spectral, oversampling)


SIGMAS = [
    pytest.param(1.5, 1.0, 0.0, False, 1.5, id="chi2 against one"),
    pytest.param(3.0, 2.0, 0.0, False, 1.5, id="chi2 against a common level"),
    pytest.param(0.7, 1.0, 0.0, True, 0.7, id="a spectrum of noise is white"),
    pytest.param(1.3, 1.0, 0.1, True, 1.0, id="a model's error may pile up in a spectrum fourfold"),
    pytest.param(0.95, 1.0, 0.1, True, 1.0, id="or be missing from it"),
    pytest.param(2.8, 1.0, 0.1, True, 2.0, id="what is more counts from there"),
    pytest.param(0.45, 1.0, 0.1, True, 0.5, id="what is less as well"),
]


@pytest.mark.parametrize(("chi2", "level", "share", "spectral", "ratio"), SIGMAS)
def test_significance_of_an_entry(chi2: float, level: float, share: float, spectral: bool, ratio: float) -> None:
    found = axis(np.array([chi2]), 50, spectral).sigma(Freedom(share), level)
    # Chi^2 scaled by c with that many fewer degrees of freedom.
    c = 1 + share
    assert found == pytest.approx(chi2_sigma(100 * ratio / c, 100 / c), rel=1e-9)


def test_unevenness_of_noise_is_standard_normal() -> None:
    """Whatever its level, and where entries are oversampled."""
    rng = generator(5, "uneven")
    found = []
    for level in (1.0, 7.0):
        some = [axis(level * rng.chisquare(2 * 50, 12) / 100, 50) for _ in range(400)]
        found.append([one.unevenness(Freedom(0.0)) for one in some])
        twice = [
            replace(one, oversampling=2.0, **{k: np.repeat(getattr(one, k), 2) for k in ("n", "power", "values")})
            for one in some
        ]
        twice = [replace(one, what=list(range(24))) for one in twice]
        found.append([one.unevenness(Freedom(0.0)) for one in twice])
    assert np.abs(np.mean(found, axis=1)).max() < 0.2
    assert np.abs(np.std(found, axis=1) - 1).max() < 0.15


def test_uneven_entries_are_uneven_at_any_level() -> None:
    uneven = np.array([1.0, 1.0, 1.0, 2.0])
    assert axis(uneven, 200).unevenness(Freedom(0.0)) > 5
    assert axis(9 * uneven, 200).unevenness(Freedom(0.0)) == pytest.approx(axis(uneven, 200).unevenness(Freedom(0.0)))
    assert axis(uneven, 200).unevenness(Freedom(1.0)) < axis(uneven, 200).unevenness(Freedom(0.0))
    assert axis(uneven[:1], 200).unevenness(Freedom(0.0)) == 0.0
