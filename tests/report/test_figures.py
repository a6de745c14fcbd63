"""The figures show the numbers that they should, computed here by other means."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from scipy.stats import halfnorm, rayleigh

from hydrabeam_mpi.inference.predictive_checks import Z_EDGES
from hydrabeam_mpi.report.beam import correlation
from hydrabeam_mpi.report.beam.coefficients import draw_coefficients
from hydrabeam_mpi.report.beam.correlation import draw_correlation, strongest
from hydrabeam_mpi.report.beam.eigenbeams import draw_eigenbeams, with_real_peak
from hydrabeam_mpi.report.beam.frequencies import draw_frequencies
from hydrabeam_mpi.report.beam.predictive_checks import draw_heldout_scores, merge_bins
from hydrabeam_mpi.report.beam.sky import difference, draw_map_scores, draw_maps, draw_slices, expected_scores, scores
from hydrabeam_mpi.report.figures import shown_channels
from hydrabeam_mpi.report.page.projection import to_disc
from hydrabeam_mpi.report.page.result import Channel, load_result
from hydrabeam_mpi.report.page.style import STYLE, Drawing, render


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    """Draw as the report does."""
    with matplotlib.rc_context(STYLE):
        yield


def lines(drawing: Drawing | None, panel: int) -> dict[str, np.ndarray]:
    """The y values of a panel's labelled lines."""
    assert drawing is not None
    return {str(line.get_label()): np.asarray(line.get_ydata()) for line in drawing.figure.axes[panel].lines}


def images(drawing: Drawing | None) -> list[np.ma.MaskedArray]:
    """The arrays of a figure's images, colour bars aside."""
    assert drawing is not None
    return [np.ma.masked_invalid(axes.images[0].get_array()) for axes in drawing.figure.axes if axes.images]


def test_coefficients_and_their_updates(paper_channel: Channel) -> None:
    arrays = paper_channel.arrays
    drawing = draw_coefficients(paper_channel)
    top = lines(drawing, 0)
    np.testing.assert_array_equal(top["|MAP|"], np.abs(arrays["mean"]))
    np.testing.assert_array_equal(top["posterior standard deviation"], arrays["std"])
    np.testing.assert_array_equal(top["prior standard deviation"], arrays["prior_std"])
    update = np.asarray(drawing.figure.axes[1].lines[0].get_ydata())
    np.testing.assert_allclose(update, np.abs((arrays["mean"] - arrays["prior_mean"]) / arrays["std"]))
    assert f"{paper_channel.numbers['z_update_above_10']} modes are moved by more than 10σ" in drawing.caption


def test_a_flat_prior_has_no_line(bands_channel: Channel) -> None:
    drawing = draw_coefficients(bands_channel)
    assert "prior standard deviation" not in lines(drawing, 0)
    assert "the prior is flat" in drawing.caption


def test_correlations_stand_in_blocks_of_equal_m(paper_channel: Channel) -> None:
    covariance = paper_channel.covariance()
    drawing = draw_correlation(paper_channel, covariance)
    modes = paper_channel.basis["modes"]
    order = sorted(range(len(modes)), key=lambda n: (modes[n][1], n))
    expected = np.array(
        [[covariance[i, j].real / np.sqrt(covariance[i, i].real * covariance[j, j].real) for j in order] for i in order]
    )
    np.testing.assert_allclose(images(drawing)[0], expected, rtol=1e-12)
    labels = [text.get_text() for text in drawing.figure.axes[0].get_xticklabels()]
    assert set(labels) <= {str(m).replace("-", "−") for _, m in modes}
    assert "0" in labels


def test_a_basis_without_m_keeps_its_order(bands_channel: Channel) -> None:
    covariance = bands_channel.covariance()
    plain = replace(bands_channel, basis={"kind": "zernike"})
    drawing = draw_correlation(plain, covariance)
    np.testing.assert_allclose(images(drawing)[0], covariance / np.outer(plain.arrays["std"], plain.arrays["std"]))
    axes, n = drawing.figure.axes[0], len(covariance)
    assert axes.get_xlabel() == "mode number"
    # The first is number one, as in the figure of the coefficients.
    assert axes.images[0].get_extent() == [0.5, n + 0.5, n + 0.5, 0.5]


def test_a_large_matrix_is_reduced_to_its_strongest_entries() -> None:
    matrix = np.array([[1.0, 0.1, -0.5], [0.1, 1.0, 0.2], [-0.5, 0.2, 1.0]])
    np.testing.assert_array_equal(strongest(matrix, 2), [[1.0, -0.5], [-0.5, 1.0]])
    assert strongest(matrix, 1) is matrix


def test_the_reduced_picture_says_so(paper_channel: Channel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correlation, "MOST_PIXELS", 15)
    drawing = draw_correlation(paper_channel, paper_channel.covariance())
    n = len(paper_channel.arrays["mean"])
    block = -(-n // 15)
    assert images(drawing)[0].shape == (-(-n // block),) * 2
    assert f"strongest of {block} × {block} entries" in drawing.caption


def test_eigenbeams_have_both_parts_only_where_complex(paper_channel: Channel, bands_channel: Channel) -> None:
    for channel, parts in ((paper_channel, 2), (bands_channel, 1)):
        drawing = draw_eigenbeams(channel, channel.covariance())
        assert len(images(drawing)) == parts * len(channel.arrays["eigen_beams"])
        assert drawing is not None
        drawing.figure.draw_without_rendering()
        top = drawing.figure.bbox.y1
        assert all(top - axes._left_title.get_window_extent().y1 > 2 for axes in drawing.figure.axes if axes.images)
        spectrum = np.asarray(drawing.figure.axes[-1].lines[0].get_ydata())
        np.testing.assert_allclose(spectrum, np.sqrt(np.linalg.eigvalsh(channel.covariance())), rtol=1e-4)


def test_an_eigenvectors_phase_is_turned_not_its_size() -> None:
    beam = np.array([[1 + 1j, -2j], [0.5, 0.0]])
    turned = with_real_peak(beam)
    np.testing.assert_allclose(np.abs(turned), np.abs(beam))
    assert turned[0, 1] == pytest.approx(2)
    np.testing.assert_array_equal(with_real_peak(-np.eye(2)), np.eye(2))
    np.testing.assert_array_equal(with_real_peak(np.zeros((2, 2))), 0)


def test_maps_show_beam_std_error_and_score(paper_channel: Channel) -> None:
    arrays = paper_channel.arrays
    beam, std, error, score = images(draw_maps(paper_channel))
    expected = arrays["map_truth"] - arrays["map_mean"]
    for image, values in (
        (std, arrays["map_std"]),
        (error, expected.real),
        (score, np.abs(expected) / arrays["map_std"]),
    ):
        np.testing.assert_array_equal(
            image.filled(0), np.nan_to_num(to_disc(values, paper_channel.za, paper_channel.az))
        )
    positive = np.where(arrays["map_mean"].real > 0, arrays["map_mean"].real, np.nan)
    np.testing.assert_array_equal(
        np.ma.getmaskarray(beam), np.isnan(to_disc(positive, paper_channel.za, paper_channel.az))
    )


def test_negative_power_is_white(paper_channel: Channel) -> None:
    arrays = dict(paper_channel.arrays, map_mean=paper_channel.arrays["map_mean"].copy())
    arrays["map_mean"][30:40] = -1e-3
    drawing = draw_maps(replace(paper_channel, arrays=arrays))
    assert drawing is not None
    beam = images(drawing)[0]
    north = int((1 + np.sqrt(1 - np.cos(np.deg2rad(35)))) / 2 * len(beam))
    white = np.ma.getmaskarray(beam)[:, len(beam) // 2]
    assert white[north]
    assert not white[len(beam) // 2]
    assert drawing.figure.axes[0].images[0].cmap.get_bad()[3] == 0  # transparent: the page's white
    assert "White: the real part is negative" in drawing.caption


def test_slices_run_along_east_and_north(paper_channel: Channel) -> None:
    arrays = dict(paper_channel.arrays, map_mean=np.abs(paper_channel.arrays["map_mean"]) + 1e-9j)
    drawing = draw_slices(replace(paper_channel, arrays=arrays))
    top, bottom = lines(drawing, 0), lines(drawing, 1)
    np.testing.assert_array_equal(top["MAP, az = 0°"], arrays["map_mean"][:, 0].real)
    np.testing.assert_array_equal(top["truth, az = 90°"], arrays["map_truth"][:, 90])
    np.testing.assert_array_equal(bottom["posterior std, az = 90°"], arrays["map_std"][:, 90])
    np.testing.assert_allclose(bottom["|truth − MAP|, az = 0°"], np.abs(arrays["map_truth"] - arrays["map_mean"])[:, 0])


def test_slices_of_a_negative_beam_show_its_amplitude(paper_channel: Channel) -> None:
    arrays = dict(paper_channel.arrays, map_mean=-paper_channel.arrays["map_mean"])
    drawing = draw_slices(replace(paper_channel, arrays=arrays))
    np.testing.assert_array_equal(lines(drawing, 0)["MAP, az = 90°"], np.abs(arrays["map_mean"])[:, 90])
    assert drawing is not None
    assert "(amplitude)" in drawing.caption


def test_without_truth_the_difference_is_the_update(bands_channel: Channel) -> None:
    update, name = difference(bands_channel)
    np.testing.assert_array_equal(update, bands_channel.arrays["map_mean"] - bands_channel.arrays["map_model"])
    assert name == "MAP − model"
    assert "model, az = 0°" in lines(draw_slices(bands_channel), 0)


def test_where_all_modes_vanish_there_is_no_score(paper_channel: Channel) -> None:
    std = paper_channel.arrays["map_std"].copy()
    std[-1], std[-2] = 0, 1e-17  # as a Dirichlet edge at the horizon makes it, up to rounding
    channel = replace(paper_channel, arrays=dict(paper_channel.arrays, map_std=std))
    z = scores(channel)
    assert np.isnan(z[-2:]).all()
    np.testing.assert_allclose(z[:-2], scores(paper_channel)[:-2])
    drawings = draw_maps(channel), draw_slices(channel), draw_map_scores(channel)
    assert all(drawing is not None and render(drawing.figure)["png"] for drawing in drawings)


@pytest.mark.parametrize(("is_complex", "law"), [(True, rayleigh(scale=np.sqrt(0.5))), (False, halfnorm())])
def test_scores_are_compared_with_the_right_law(is_complex: bool, law: object) -> None:
    z = np.linspace(0, 5, 50)
    density, name = expected_scores(z, is_complex)
    np.testing.assert_allclose(density, law.pdf(z), rtol=1e-12)  # type: ignore[attr-defined]
    assert name == ("Rayleigh distribution" if is_complex else "half-normal distribution")


@pytest.mark.parametrize("scale", [1.0, 300.0])
def test_map_scores_are_a_density(paper_channel: Channel, scale: float) -> None:
    rng = np.random.default_rng(1)
    truth = rng.rayleigh(np.sqrt(0.5), (91, 360)) * scale
    arrays = dict(paper_channel.arrays, map_truth=truth, map_mean=np.zeros((91, 360)), map_std=np.ones((91, 360)))
    drawing = draw_map_scores(replace(paper_channel, arrays=arrays))
    assert drawing is not None
    density, edges, _ = drawing.figure.axes[0].patches[1].get_data()  # type: ignore[attr-defined]
    assert np.sum(density * np.diff(edges)) == pytest.approx(1, abs=2e-3)
    np.testing.assert_allclose(np.sum(density * np.diff(edges) * (edges[1:] + edges[:-1]) / 2), truth.mean(), rtol=0.02)


def test_heldout_scores_are_densities(paper_channel: Channel) -> None:
    drawing = draw_heldout_scores(paper_channel)
    assert drawing is not None
    for patch in drawing.figure.axes[0].patches:
        density, edges, _ = patch.get_data()  # type: ignore[attr-defined]
        assert np.sum(density * np.diff(edges)) == pytest.approx(1)
        assert 0 in edges


@pytest.mark.parametrize("n", [100, 10_000, 1_000_000])
def test_merged_bins_keep_all_counts(n: int) -> None:
    counts = np.histogram(np.random.default_rng(n).standard_normal(n), Z_EDGES)[0]
    edges, merged = merge_bins(Z_EDGES, counts)
    assert merged.sum() == n
    assert (edges[0], edges[-1]) == (Z_EDGES[0], Z_EDGES[-1])
    np.testing.assert_array_equal(np.cumsum(merged), np.cumsum(counts)[np.searchsorted(Z_EDGES, edges[1:]) - 1])


def test_numbers_against_frequency(bands: Path) -> None:
    channels = load_result(bands).channels
    channels[1].numbers["heldout_chi2_noise_only"] = 3.0  # known in one channel only
    drawing = draw_frequencies(channels)
    assert drawing is not None
    first = drawing.figure.axes[0]
    assert first.get_title(loc="left") == "held-out reduced χ² over the noise"
    np.testing.assert_array_equal(first.lines[0].get_ydata(), [np.nan, 3.0, np.nan, np.nan])
    np.testing.assert_allclose(np.asarray(first.lines[0].get_xdata()), [120, 130, 140, 150])
    assert draw_frequencies(channels[:1]) is None
    for channel in channels:
        channel.numbers.clear()
        channel.numbers["condition_number"] = None
    assert draw_frequencies(channels) is None


@pytest.mark.parametrize(("n", "shown"), [(1, [0]), (3, [0, 1, 2]), (4, [0, 2, 3]), (9, [0, 4, 8])])
def test_first_middle_and_last_are_shown(n: int, shown: list[int], paper_channel: Channel) -> None:
    channels = [replace(paper_channel, number=number) for number in range(n)]
    assert [channel.number for channel in shown_channels(channels)] == shown
