"""The figures of the loop show the numbers of ``loop.json``."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Text

from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS
from hydrabeam_mpi.report.loop.figures import SHOWN, draw_fall, draw_ranking
from hydrabeam_mpi.report.loop.parameters import _with_error, draw_parameters
from hydrabeam_mpi.report.loop.residuals import draw_residuals
from hydrabeam_mpi.report.loop.structures import draw_singular_values, draw_structures
from hydrabeam_mpi.report.page.places import place_words
from hydrabeam_mpi.report.page.scales import tick_label, ticks_between
from hydrabeam_mpi.report.page.style import INFERRED, STYLE, Drawing, render
from tests.report import loops


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    """Draw as the report does."""
    with matplotlib.rc_context(STYLE):
        yield


def test_bars_of_the_ranking() -> None:
    drawing = draw_ranking(loops.explained())
    assert drawing is not None
    panels = drawing.figure.axes
    assert [axes.get_title(loc="left") for axes in panels] == [
        "Round 1: antenna gains",
        "Round 2: missing sources",
        "After the last round",
    ]
    names = [text.get_text() for text in panels[0].get_yticklabels()]
    assert names[:3] == ["antenna gains", "antenna positions", "missing point sources"]
    for axes, entries in zip(panels, [one["ranking"] for one in loops.explained()["rounds"]], strict=False):
        widths = {names[round(bar.get_y() + 0.36)]: bar.get_width() for bar in axes.patches}
        titles = {kind: kinds[kind].title for kinds in (EFFECTS, REWEIGHTINGS) for kind in kinds}
        scores = {titles[one["effect"]]: one["log_bayes_factor"] for one in entries}
        assert widths == {name: scores[name] for name in names}
    assert len(names) == SHOWN < len(scores)
    assert all(axes.get_xscale() == "symlog" for axes in panels)
    assert "A dash stands for what was not weighed in that round." in drawing.caption


def test_ticks_of_the_ranking_stay_apart() -> None:
    loop = loops.explained()
    loop["rounds"] = loop["rounds"] * 2
    loop["rounds"][0]["ranking"][0]["log_bayes_factor"] = 24314.0
    drawing = draw_ranking(loop)
    assert drawing is not None
    drawing.figure.draw_without_rendering()
    texts = [text for text in drawing.figure.axes[3].get_xticklabels() if text.get_text()]
    places = [text.get_window_extent() for text in texts]
    assert [text.get_text() for text in texts] == ["0", "100", "$10^{4}$"]
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(places))


def test_an_effect_with_several_laws_has_a_bar_for_each() -> None:
    """The one that was added is the one in colour."""
    loop = loops.explained()
    first = loop["rounds"][0]
    constant, second = first["ranking"][0], {**first["ranking"][0], "law": "piecewise", "log_bayes_factor": 3.0}
    first["ranking"] = [{**constant, "law": "smooth", "log_bayes_factor": 1e6}, *first["ranking"], second]
    first["law"] = "smooth"
    drawing = draw_ranking(loop)
    assert drawing is not None
    axes = drawing.figure.axes[0]
    names = [text.get_text() for text in axes.get_yticklabels()]
    bars = {names[round(bar.get_y() + 0.36)]: bar for bar in axes.patches}
    widths = {name: bar.get_width() for name, bar in bars.items() if name.startswith("antenna gains")}
    known = constant["log_bayes_factor"]
    assert {name: widths[name] for name in widths if "jitter" not in name} == {
        "antenna gains that drift": 1e6,
        "antenna gains": known,
        "antenna gains that jump": 3.0,
    }
    added = [name for name, bar in bars.items() if to_hex(bar.get_facecolor()) == INFERRED.lower()]
    assert added == ["antenna gains that drift"]


def test_long_titles_stay_above_their_own_panels() -> None:
    loop = loops.explained()
    for entry in loop["rounds"]:
        entry["title"] = "catalogue sources that are resolved"
    drawing = draw_ranking(loop)
    assert drawing is not None
    drawing.figure.draw_without_rendering()
    words = [text for axes in drawing.figure.axes for text in axes.get_children() if isinstance(text, Text)]
    places = [text.get_window_extent() for text in words if text.get_text() == text.axes.get_title(loc="left")]
    assert len(places) == 3
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(places))


def test_the_fall() -> None:
    drawing = draw_fall(loops.explained())
    assert drawing is not None
    reference, curve = drawing.figure.axes[0].lines
    np.testing.assert_array_equal(curve.get_ydata(), [11.4, 2.31, 1.03])
    np.testing.assert_array_equal(reference.get_ydata(), [1, 1])
    assert draw_fall(loops.consistent()) is None


def test_errors_below_the_noise_are_written_below_it() -> None:
    loop = loops.explained()
    loop["rounds"][1]["heldout_after"] = 0.963
    drawing = draw_fall(loop)
    assert drawing is not None
    axes = drawing.figure.axes[0]
    drawing.figure.draw_without_rendering()
    (last,) = (text for text in axes.texts if text.get_text() == "0.963")
    line = axes.transData.transform((0, 1))[1]
    assert axes.bbox.y0 < last.get_window_extent().y0 < last.get_window_extent().y1 < line


def test_the_fall_goes_on_where_the_prior_was_adapted() -> None:
    loop = loops.explained()
    adapted = [{"n_rounds": number, "predictive_chi2_after": chi2} for number, chi2 in ((0, 11.4), (1, 1.9), (2, 1.01))]
    drawing = draw_fall(loop | {"prior_widths": adapted})
    assert drawing is not None
    _, curve = drawing.figure.axes[0].lines
    np.testing.assert_array_equal(curve.get_ydata(), [11.4, 2.31, 1.9, 1.03, 1.01])


def test_parameters_over_antennas() -> None:
    drawing = draw_parameters(loops.gains_round(), 1)
    assert drawing is not None
    assert [axes.get_title(loc="left") for axes in drawing.figure.axes] == ["antenna ln amplitude", "antenna phase"]
    x, y = drawing.figure.axes[0].lines[1].get_data()
    np.testing.assert_array_equal(x, loops.ANTENNAS)
    expected = [one["value"] for one in loops.gains_round()["parameters"] if one["name"].endswith("amplitude")]
    np.testing.assert_array_equal(y, expected)


def test_parameters_of_times_are_told_by_these() -> None:
    """Of each antenna by itself, from the day's beginning."""
    jds = 2459866.25 + 0.0625 * np.arange(8)
    names = [f"antenna {number} phase at JD {jd:.5f}" for number in (2, 3) for jd in jds]
    told = [loops.parameter(name, 0.1, 0.01, "rad", None) for name in names]
    drawing = draw_parameters({"effect": "gain_jitter", "parameters": told}, 1)
    assert drawing is not None
    panels = drawing.figure.axes[:2]
    assert [axes.get_title(loc="left") for axes in panels] == ["antenna 2 phase at JD", "antenna 3 phase at JD"]
    assert panels[0].get_xlabel() == "JD − 2459866"
    np.testing.assert_allclose(panels[0].lines[1].get_xdata(), jds - 2459866)


def test_values_are_written_to_the_digits_of_their_errors() -> None:
    """And a place on the horizon is shown where it is, not from zero."""
    power, place = "emitter at azimuth 298.61 deg: power", "emitter at azimuth 298.61 deg: azimuth"
    told = [loops.parameter(power, 0.0200063, 6.8e-5, "Jy"), loops.parameter(place, 298.6116, 0.0029, "deg")]
    drawing = draw_parameters({"effect": "ground_emitter", "parameters": told}, 1)
    assert drawing is not None
    written = [
        text.get_text() for axes in drawing.figure.axes for one in axes.child_axes for text in one.get_yticklabels()
    ]
    assert written == ["0.020006 ± 0.000068", "298.6116 ± 0.0029"]
    (zero, _), (low, high) = (axes.get_xlim() for axes in drawing.figure.axes)
    assert zero < 0
    assert 298.6 < low < high < 298.62
    assert [_with_error(*one) for one in ((-0.02584, 0.0017), (1234.5, 210.0), (2e-9, 3e-10), (5.0, 0.0))] == [
        "−0.0258 ± 0.0017",
        "1234 ± 210",
        "2.00e−09 ± 3.0e−10",
        "5",
    ]


def test_a_common_power_of_ten_and_names_of_lines_have_room() -> None:
    told = [
        loops.parameter(f"coefficient of mode ({radial}, 0)", 1e-5 * radial, 1e-6, "", 1e6 * freq)
        for radial in (26, 27, 28)
        for freq in (140, 145, 150, 155)
    ]
    drawing = draw_parameters({"effect": "basis_truncation", "parameters": told}, 1)
    assert drawing is not None
    drawing.figure.draw_without_rendering()
    (axes,) = drawing.figure.axes
    legend = axes.get_legend()
    assert legend is not None
    assert axes.yaxis.get_offset_text().get_window_extent().x1 < legend.get_window_extent().x0


def test_modes_are_told_by_both_their_orders() -> None:
    modes = [(13, -16), (13, 16), (2, 0)]
    parameters = [loops.parameter(f"coefficient of mode {mode}", 1.0, 0.1) for mode in modes]
    drawing = draw_parameters(loops.gains_round() | {"parameters": parameters}, 1)
    assert drawing is not None
    (axes,) = drawing.figure.axes
    assert axes.get_title(loc="left") == "coefficient of mode"
    assert {text.get_text() for text in axes.get_yticklabels()} >= {"13, -16", "13, 16", "2, 0"}


def test_ticks_stand_at_antennas() -> None:
    numbers = range(20)
    parameters = [loops.parameter(f"antenna {number} phase", 0.1, 0.1) for number in numbers]
    drawing = draw_parameters(loops.gains_round() | {"parameters": parameters}, 1)
    assert drawing is not None
    ticks = drawing.figure.axes[0].get_xticks()
    np.testing.assert_array_equal(ticks, np.round(ticks))


def test_long_names_have_room_left_of_their_panel() -> None:
    """So panels are one below the other."""
    place = "source at ra=130.000 dec=-25.000: "
    of = [(place + "flux, level", "Jy", 1.0), (place + "flux, drift", "Jy", 0.1), (place + "declination", "deg", -25.0)]
    told = [{"name": name, "unit": unit, "value": value, "std": 0.01} for name, unit, value in of]
    drawing = draw_parameters({"effect": "missing_sources", "parameters": told}, 1)
    assert drawing is not None
    one, two = drawing.figure.axes[:2]
    assert one.get_position().y0 > two.get_position().y1


def test_many_parameters_are_bounded() -> None:
    rng = np.random.default_rng(0)
    pairs = [(i, j) for i in range(40) for j in range(i)]
    parameters = [loops.parameter(f"baseline {i}-{j} real", rng.normal(), 1.0) for i, j in pairs]
    parameters[123]["value"] = 50.0
    drawing = draw_parameters(loops.gains_round() | {"parameters": parameters}, 1)
    assert drawing is not None
    labels = [text.get_text() for text in drawing.figure.axes[0].get_yticklabels()]
    assert len(labels) == 20
    assert "–".join(map(str, pairs[123])) in labels
    assert drawing.figure.get_figheight() < 8


def test_panels_are_named_by_what_their_parameters_have_in_common() -> None:
    told = [loops.parameter(f"flux towards ra={ra:.3f} dec=-30.100", 0.1, 0.1) for ra in (8.0, 9.0, 10.0)]
    drawing = draw_parameters(loops.gains_round() | {"parameters": told}, 1)
    assert drawing is not None
    axes = drawing.figure.axes[0]
    assert axes.get_title(loc="left") == "flux towards ra, dec"
    assert next(text.get_text() for text in axes.get_yticklabels()) == "8.000 dec=-30.100"


def test_parameters_over_frequency() -> None:
    freqs = 150e6 + 1e5 * np.arange(30)
    parameters = [
        loops.parameter(f"antenna {antenna} phase", antenna * 0.01 + f / 1e9, 0.01, "rad", float(f))
        for antenna in range(50)
        for f in freqs
    ]
    drawing = draw_parameters(loops.gains_round() | {"parameters": parameters}, 1)
    assert drawing is not None
    axes = drawing.figure.axes[0]
    _, labels = axes.get_legend_handles_labels()
    assert labels == ["44", "45", "46", "47", "48", "49"]
    assert axes.get_xlabel() == "frequency (MHz)"
    render(drawing.figure)


def points(drawing: Drawing | None, label: str) -> list[np.ndarray]:
    """Before and after on the panel with this label, as (N, 2)."""
    assert drawing is not None
    (axes,) = [axes for axes in drawing.figure.axes if axes.get_xlabel().startswith(label)]
    return [np.asarray(scatter.get_offsets()) for scatter in axes.collections]


def test_residuals_before_and_after() -> None:
    loop = loops.explained()
    drawing = draw_residuals(loop)
    for state, shown in zip((loop["rounds"][0]["residual"], loop["residual"]), points(drawing, "antenna"), strict=True):
        expected = [[entry["what"], entry["chi2"]] for entry in state["axes"]["antennas"]]
        np.testing.assert_allclose(shown, expected)
    rates = [entry["what"] for entry in loop["residual"]["axes"]["fringe_rates"]]
    np.testing.assert_allclose(points(drawing, "fringe rate (mHz)")[0][:, 0], np.array(rates) * 1e3)
    assert "are not joined" not in drawing.caption


def test_one_night_is_drawn_over_sidereal_time_through_midnight() -> None:
    loop = loops.consistent()
    times = loop["residual"]["axes"]["times"]
    for place, entry in enumerate(times):
        entry["what"] = {"jd": 2458098.4 + place / 24, "lst_h": (20 + place * 1.00273791) % 24}
    shown = points(draw_residuals(loop), "local sidereal time")[0]
    np.testing.assert_allclose(shown[:, 0], 20 + np.arange(20) * 1.00273791, rtol=1e-9)


def test_several_nights_have_both_times() -> None:
    loop = loops.consistent()
    for place, entry in enumerate(loop["residual"]["axes"]["times"]):
        entry["what"]["jd"] = 2458098.25 + place
    drawing = draw_residuals(loop)
    np.testing.assert_allclose(points(drawing, "days since JD 2458098")[0][:, 0], 0.25 + np.arange(20))
    assert len(points(drawing, "local sidereal time")[0]) == 4


def test_lists_of_the_most_significant_are_not_joined() -> None:
    loop = loops.explained()
    loop["residual"]["entries"]["fringe_rates"] = 400
    drawing = draw_residuals(loop)
    assert drawing is not None
    assert "not joined" in drawing.caption


@pytest.mark.parametrize("n_freqs", [1, 6])
def test_structures_over_time_and_frequency(n_freqs: int) -> None:
    structures = loops.structures(n_freqs)
    drawing = draw_structures(structures)
    assert drawing is not None
    render(drawing.figure)
    axes = drawing.figure.axes[0]
    expected = np.array(structures["structures"][0]["pattern"]["real"])
    if n_freqs == 1:
        np.testing.assert_allclose(axes.lines[1].get_ydata(), expected[0])
        assert axes.get_xlabel() == "LST (h)"
    else:
        np.testing.assert_allclose(np.asarray(axes.collections[0].get_array()).reshape(expected.shape), expected)
    values = draw_singular_values(structures)
    assert values is not None
    np.testing.assert_allclose(values.figure.axes[0].lines[-1].get_ydata(), structures["singular_values"])


@pytest.mark.parametrize(
    ("axis", "what", "words"),
    [
        ("antennas", 23, "antenna 23"),
        ("baselines", [3, 5], "baseline 3–5"),
        ("groups", 4, "redundant group 4"),
        ("freqs", 150.25e6, "150.25 MHz"),
        ("delays", -2.5e-7, "delay −250 ns"),
        ("fringe_rates", 1e-3, "fringe rate 1.00 mHz"),
        ("times", {"jd": 2458098.5, "lst_h": 3.2}, "LST 3.20 h (JD 2458098.50000)"),
        ("unevenness", "fringe_rates", "the unevenness over fringe rates"),
        ("overall", "all", "the sum of all data"),
    ],
)
def test_places_in_words(axis: str, what: Any, words: str) -> None:
    assert place_words(axis, what) == words


def test_ticks_are_plain_numbers() -> None:
    assert ticks_between(0.9, 12) == [1, 2, 5, 10]
    assert ticks_between(0.5, 2000) == [1, 10, 100, 1000]
    assert len(ticks_between(1e-3, 1e12)) <= 6
    assert ticks_between(0.8, 1.5) == pytest.approx([0.8, 1.0, 1.2, 1.4])
    assert [tick_label(value) for value in (0.5, 1000, 2e5, -1e6)] == [
        "0.5",
        "1,000",
        r"$2\times 10^{5}$",
        "$-10^{6}$",
    ]
