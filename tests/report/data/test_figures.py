"""What is kept of held-out visibilities, and what figures make of it."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.report.data.array import draw_array
from hydrabeam_mpi.report.data.baselines import draw_baselines
from hydrabeam_mpi.report.data.sample import AFTER, BEFORE, Sample, continued, sample_of
from hydrabeam_mpi.report.data.spectra import draw_spectra, longest_even_run
from hydrabeam_mpi.report.data.tracks import draw_tracks
from hydrabeam_mpi.report.data.visibilities import draw_visibilities, draw_waterfall
from hydrabeam_mpi.report.page.result import Result, load_result
from hydrabeam_mpi.report.page.style import STYLE


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    """Draw as the report does."""
    with matplotlib.rc_context(STYLE):
        yield


@pytest.fixture(scope="module")
def result(paper: Path) -> Result:
    return load_result(paper)


@pytest.fixture
def sample(result: Result) -> Sample:
    sample = sample_of(result, result.channels[0])
    assert sample is not None
    return sample


def test_the_sample_has_the_residuals_of_the_summary(result: Result, sample: Sample, paper: Path) -> None:
    """All rows of so small a job are in it."""
    summary = json.loads((paper / "summary.json").read_text())
    for name, key in ((BEFORE, "heldout_chi2_unperturbed"), (AFTER, "heldout_chi2_noise_only")):
        chi2 = np.nanmean(np.abs(sample.residuals[name]) ** 2 / sample.noise**2)
        assert chi2 == pytest.approx(summary[key], rel=1e-3)  # kept in single precision
    arrays = result.channels[0].arrays
    mean = np.average(arrays["baseline_chi2"], weights=arrays["baseline_n"], axis=1)
    expected = [summary["heldout_chi2_unperturbed"], summary["heldout_chi2_noise_only"]]
    np.testing.assert_allclose(mean, expected, rtol=1e-5)


def test_baselines_are_named_and_sorted_by_length(sample: Sample) -> None:
    lengths = np.linalg.norm(sample.vectors, axis=1)
    assert np.all(np.diff(lengths) > -1e-3)
    east, north, _ = sample.vectors[0]
    assert sample.name(
        0
    ) == f"{sample.antennas[0, 0]}–{sample.antennas[0, 1]}, {east:.0f} m E, {north:.0f} m N".replace("-", "−")


def test_data_and_residual_are_drawn(sample: Sample) -> None:
    worst = 7
    after = sample.after.copy()
    after[:, worst] += 1e3
    drawing = draw_visibilities(replace(sample, after=after))
    assert drawing is not None
    grid = np.array(drawing.figure.axes).reshape(3, -1)
    assert sample.name(worst) in [axes.get_title(loc="left") for axes in grid[0]]
    amplitude, _, left = grid[:, 0]
    np.testing.assert_allclose(amplitude.lines[-1].get_ydata(), np.abs(sample.data[:, 0]), rtol=1e-6)
    np.testing.assert_allclose(left.lines[1].get_ydata(), np.abs(sample.data - sample.after)[:, 0], rtol=1e-6)
    nothing = replace(sample, weights=np.zeros_like(sample.weights))
    assert draw_visibilities(nothing) is None
    assert draw_waterfall(nothing) is None


def test_the_waterfall_has_flagged_samples_grey(sample: Sample) -> None:
    weights = sample.weights.copy()
    weights[1, 3] = 0
    drawing = draw_waterfall(replace(sample, weights=weights))
    assert drawing is not None
    shown = np.ma.masked_invalid(drawing.figure.axes[1].images[0].get_array())
    assert np.argwhere(np.ma.getmaskarray(shown)).tolist() == [[1, 3]]


def test_times_beside_the_waterfall_are_evenly_spread(sample: Sample) -> None:
    parts = {name: np.repeat(getattr(sample, name), 5, axis=0) for name in ("data", "before", "after", "weights")}
    longer = replace(sample, **parts, jd=np.arange(20.0), hours=np.arange(20.0))
    drawing = draw_waterfall(longer)
    assert drawing is not None
    np.testing.assert_array_equal(drawing.figure.axes[0].get_yticks(), np.arange(0, 20, 2))


def made(n_times: int, freqs: FloatArray, rate: float, delay: float) -> list[Sample]:
    """A tone of 10 Jy in noise of 2 Jy that the model beam does not predict, and what was inferred does."""
    rng = np.random.default_rng(1)
    jd = 2459866.0 + np.arange(n_times) * 20 / 86400
    samples = []
    for freq in freqs.tolist():
        phase = 2 * np.pi * (rate * np.arange(n_times) * 20 + delay * freq)
        tone = 10 * np.exp(1j * phase)[:, np.newaxis] * np.ones(30)
        noise = rng.normal(scale=2**0.5, size=(2, *tone.shape))
        samples.append(
            Sample(
                freq, jd, np.arange(n_times) / 100, np.zeros((30, 2), int), np.tile([10.0, 0, 0], (30, 1)),
                tone + noise[0] + 1j * noise[1], np.zeros_like(tone), tone, np.full(tone.shape, 0.25),
            )
        )  # fmt: skip
    return samples


def test_a_tone_is_where_it_belongs_and_noise_has_its_variance() -> None:
    freqs = 130e6 + 1e5 * np.arange(16)
    drawing = draw_spectra(made(64, freqs, rate=5e-3, delay=-1.25e-6))
    assert drawing is not None
    for axes, place in zip(drawing.figure.axes, (5.0, -1250.0), strict=True):
        x = axes.lines[0].get_xdata()
        powers = {str(line.get_label()): np.asarray(line.get_ydata()) for line in axes.lines}
        assert x[powers["data"].argmax()] == pytest.approx(place, abs=0.6 * (x[1] - x[0]))
        np.testing.assert_array_equal(powers["data"], powers[BEFORE])
        np.testing.assert_allclose(powers["noise"], 4.0)
        assert powers[AFTER].mean() == pytest.approx(4.0, rel=0.15)
    assert draw_spectra(made(4, freqs[:4], 0.0, 0.0)) is None


def test_runs_end_at_gaps() -> None:
    x = np.array([0, 1, 2, 10, 11, 12, 13, 14, 20.0])
    assert longest_even_run(x).tolist() == [3, 4, 5, 6, 7]


def test_hours_go_on_beyond_midnight() -> None:
    np.testing.assert_allclose(continued(np.array([23.0, 0.5, 2.0, 22.0])), [23.0, 24.5, 26.0, 22.0])


def test_the_array_shows_antennas_by_what_is_wrong_with_them(result: Result) -> None:
    channel = result.channels[0]
    chi2 = channel.arrays["baseline_chi2"].copy()
    chi2[1] = np.where((result.observed["baselines"] == 3).any(axis=1), 50.0, 1.0)
    drawing = draw_array(result, replace(channel, arrays=channel.arrays | {"baseline_chi2": chi2}))
    assert drawing is not None
    values = np.asarray(drawing.figure.axes[0].collections[1].get_array())
    assert result.observed["antenna_numbers"][values.argmax()] == 3
    assert values.max() == pytest.approx(50.0)
    # One group for each of the 18 vectors of 7 antennas on a hexagon that differ but for their sign: 9 of them.
    assert len(drawing.figure.axes[1].collections[0].get_offsets()) == len(result.observed["baseline_vectors"]) == 9


def test_gains_colour_the_array_where_there_are_any(result: Result) -> None:
    numbers = result.observed["antenna_numbers"].tolist()
    found = {"ln_amplitude": [0.1 * (number == 2) for number in numbers]}
    told = {"antennas": numbers, "channels": [{"found": found}]}
    drawing = draw_array(replace(result, numbers=result.numbers | {"gains": told}), result.channels[0])
    assert drawing is not None
    values = np.asarray(drawing.figure.axes[1].collections[1].get_array())
    assert values[numbers.index(2)] == pytest.approx(100 * np.expm1(0.1))
    # All three stand side by side, and numbers below the antennas do not touch the axis.
    drawing.figure.draw_without_rendering()
    panels = drawing.figure.axes[:3]
    np.testing.assert_allclose(
        np.ptp([(one.get_position().y0, one.get_position().y1) for one in panels], axis=0), 0, atol=0.01
    )
    for axes in panels[:2]:
        assert min(text.get_window_extent().y0 for text in axes.texts) > axes.bbox.y0


def test_all_pairs_are_in_the_map_of_baselines(result: Result) -> None:
    drawing = draw_baselines(result, result.channels[0])
    assert drawing is not None
    before, after = (np.ma.filled(axes.images[0].get_array(), np.nan) for axes in drawing.figure.axes[:2])
    assert np.isfinite(before).sum() == np.isfinite(after).sum() == 7 * 6
    np.testing.assert_array_equal(after, after.T)
    one, two = result.observed["baselines"][5]
    assert after[one, two] == result.channels[0].arrays["baseline_chi2"][1, 5]


def test_sources_move_westwards(result: Result) -> None:
    drawing = draw_tracks(result, result.channels[0])
    assert drawing is not None
    lines = [line for line in drawing.figure.axes[0].lines if line.get_marker() != "o"]
    assert len(lines) == 2 * len(result.observed["track_flux"])
    east, north = (np.asarray(values) for values in (lines[0].get_xdata(), lines[0].get_ydata()))
    assert np.nanmax(np.hypot(east, north)) <= 1
    assert np.nansum(np.diff(east)) < 0
    # What they are called stands beside the disc, with lines to the dots, no two upon each other.
    drawing.figure.draw_without_rendering()
    named = [text for text in drawing.figure.axes[0].texts if text.get_text().endswith(" Jy")]
    dots = [line.get_xydata()[0].tolist() for line in drawing.figure.axes[0].lines if line.get_marker() == "o"]
    assert len(named) == 3
    assert all(list(text.xy) in dots for text in named)
    assert all(text.anncoords == "data" and abs(text.xyann[0]) > 1 for text in named)
    boxes = [Bbox.from_extents(*Text.get_window_extent(text).extents) for text in named]
    assert not any(one.overlaps(two) for one, two in itertools.combinations(boxes, 2))
