"""Where the residual lives, before the first round and after the last: over antennas, times, frequencies and so on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.loop.record import Entry, axis_entries, first_statistics, is_complete, number
from hydrabeam_mpi.report.page.scales import scale_values
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure

SIGNIFICANT = 5.0  # standard deviations above which a marker is filled
ONE_NIGHT = 0.9  # days
DAYLIGHT = 0.25  # days without data beyond which markers are not joined
SIDEREAL_HOURS = 24 * 1.00273791  # in a day
BEFORE, AFTER = "before the first round", "after the last round"


@dataclass(frozen=True)
class _Axis:
    """How a quantity that the residual is sorted by is drawn: its words, and the factor from its unit."""

    label: str
    factor: float = 1.0


AXES = {
    "antennas": _Axis("antenna"),
    "lsts": _Axis("local sidereal time (h)"),
    "times": _Axis("days since JD {}"),
    "night": _Axis("local sidereal time (h)"),
    "freqs": _Axis("frequency (MHz)", 1e-6),
    "lengths": _Axis("baseline length (m)"),
    "directions": _Axis("baseline direction (deg, from East through North)"),
    "fringe_rates": _Axis("fringe rate (mHz)", 1e3),
    "delays": _Axis("delay (ns)", 1e9),
}


@dataclass(frozen=True, eq=False)
class _Curve:
    """One state of the model along one axis.

    Attributes
    ----------
    place, chi2, sigma : ndarray, (N,)
        Where, in drawn units and ascending; reduced χ²; its significance.
    complete : bool
        Whether all entries of the axis are known, or the most significant ones alone.
    """

    place: Array
    chi2: Array
    sigma: Array
    complete: bool


def draw_residuals(loop: Entry) -> Drawing | None:
    """Draw reduced χ² over everything that it is sorted by, before the first round and after the last one."""
    states = {BEFORE: first_statistics(loop), AFTER: loop.get("residual")}
    panels = []
    night = all(_is_one_night(state) for state in states.values() if state)
    for name in [name for name in AXES if name not in (("lsts", "times") if night else ("night",))]:
        curves = {label: curve for label, state in states.items() if (curve := _curve(name, state))}
        if any(len(curve.place) > 1 for curve in curves.values()):
            panels.append((name, curves))
    if not panels:
        return None
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure = new_figure(2.0 * rows + 0.35)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, curves) in zip(grid, panels, strict=False):
        _draw_panel(axes, name, curves)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    labels = {label for _, curves in panels for label in curves}
    figure.legend(handles=_legend(labels), loc="outside upper center", ncols=3)
    some = any(not curve.complete for _, curves in panels for curve in curves.values())
    return Drawing(
        "loop_residuals",
        "Where the residual lives",
        f"Reduced χ² of the held-out visibilities{f', {BEFORE} and {AFTER}' if len(labels) > 1 else ''}, sorted in "
        f"several ways; noise alone gives 1. Filled markers are more than {SIGNIFICANT:.0f}σ away from it, hollow ones "
        "are not." + (" Where markers are not joined only the most significant ones are known." if some else ""),
        f"{len(panels)} panels with reduced χ² over " + ", ".join(name.replace("_", " ") for name, _ in panels) + ".",
        figure,
    )


def _is_one_night(statistics: Entry) -> bool:
    """Tell whether all times are known, with their sidereal ones, and are of one night."""
    whats = [entry.get("what") for entry in axis_entries(statistics, "times")]
    times = [(number(what, "jd"), number(what, "lst_h")) for what in whats if isinstance(what, dict)]
    jds = [jd for jd, lst in times if math.isfinite(jd + lst)]
    return len(whats) == len(jds) > 1 and max(jds) - min(jds) < ONE_NIGHT and is_complete(statistics, "times")


def _curve(name: str, statistics: Entry | None) -> _Curve | None:
    """Return what is known along an axis; None where nothing is."""
    source = "times" if name == "night" else name
    listed = axis_entries(statistics, source)
    rows = [(_place(name, entry.get("what")), number(entry, "chi2"), number(entry, "sigma")) for entry in listed]
    points = np.array([row for row in rows if math.isfinite(row[0]) and math.isfinite(row[1])]).reshape(-1, 3)
    if not len(points):
        return None
    place, chi2, sigma = points[np.argsort(points[:, 0], kind="stable")].T
    if name == "night":  # sidereal times go on ascending beyond 24 h
        first = min(listed, key=lambda entry: number(entry["what"], "jd"))
        place = number(first["what"], "lst_h") + (place - place[0]) * SIDEREAL_HOURS
    return _Curve(place, chi2, sigma, is_complete(statistics, source))


def _place(name: str, what: Any) -> float:
    """Return where on its axis something is; NaN where that is no number."""
    if isinstance(what, dict):
        what = what.get("jd")
    if not isinstance(what, int | float):
        return math.nan
    return float(what) * AXES[name].factor


def _draw_panel(axes: Axes, name: str, curves: dict[str, _Curve]) -> None:
    drawn = [*curves.values()]
    start = math.floor(min(curve.place[0] for curve in drawn)) if name == "times" else 0
    axes.axhline(1, color=REFERENCE, linestyle="--", linewidth=0.9)
    for label, curve in curves.items():
        colour = _colour(label)
        if curve.complete and name != "antennas":
            gap = DAYLIGHT if name == "times" else np.inf
            nights = np.flatnonzero(np.diff(curve.place) > gap) + 1
            for night in np.split(np.arange(len(curve.place)), nights):
                axes.plot(curve.place[night] - start, curve.chi2[night], color=colour, linewidth=0.7, alpha=0.6)
        faces = [colour if abs(sigma) > SIGNIFICANT else "white" for sigma in curve.sigma]
        size = 14 if len(curve.place) <= 40 else 7
        axes.scatter(curve.place - start, curve.chi2, s=size, c=faces, edgecolors=colour, linewidths=0.8, zorder=3)
    scale_values(axes, [1.0, *(value for curve in drawn for value in curve.chi2.tolist())])
    axes.set(ylabel="reduced χ²", xlabel=AXES[name].label.format(start))
    if name == "antennas":
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if name == "night":
        axes.xaxis.set_major_formatter(lambda lst, _: f"{lst % 24:.4g}")
    axes.grid()


def _colour(label: str) -> str:
    return MODEL if label == BEFORE else INFERRED


def _legend(labels: set[str]) -> list[Line2D]:
    names = {BEFORE: BEFORE, AFTER: AFTER if len(labels) > 1 else "residual"}
    handles = [
        Line2D([], [], marker="o", markersize=4.5, linewidth=0.8, color=_colour(label), label=names[label])
        for label in (BEFORE, AFTER)
        if label in labels
    ]
    return [*handles, Line2D([], [], linestyle="--", linewidth=0.9, color=REFERENCE, label="noise alone")]
