"""The residual of every baseline, as a map over pairs of antennas."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.colors import LogNorm

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.loop.record import Entry, axis_entries, first_statistics, is_complete, number
from hydrabeam_mpi.report.loop.residuals import AFTER, BEFORE
from hydrabeam_mpi.report.page.scales import tick_label, ticks_between
from hydrabeam_mpi.report.page.style import Drawing, colour_map, new_figure

FEW_ANTENNAS = 40  # up to here a map with some of the baselines is worth drawing


def draw_baselines(loop: Entry) -> Drawing | None:
    """Draw reduced χ² of every pair of antennas, before and after; None where too little is known."""
    states = {BEFORE: first_statistics(loop), AFTER: loop.get("residual")}
    maps = {label: pairs for label, state in states.items() if len(pairs := _pairs(state)) > 2}
    numbers = np.unique(np.concatenate([np.zeros((0, 2)), *(pairs[:, :2] for pairs in maps.values())]))
    complete = all(is_complete(states[label], "baselines") for label in maps)
    if not maps or (len(numbers) > FEW_ANTENNAS and not complete):
        return None
    values = np.concatenate([pairs[:, 2] for pairs in maps.values()])
    low, high = float(np.percentile(values, 0.5)), float(np.percentile(values, 99.5))
    low, high = max(min(low, 0.8), 0.1), max(high, 1.5)
    figure = new_figure(3.7)
    every = -(-len(numbers) // 10)
    ticks = np.arange(0, len(numbers), every)
    panels = figure.subplots(1, 2)
    images = []
    for axes, (label, pairs) in zip(panels, maps.items(), strict=False):
        square = np.full((len(numbers), len(numbers)), np.nan)
        first, second = np.searchsorted(numbers, pairs[:, 0]), np.searchsorted(numbers, pairs[:, 1])
        square[first, second] = square[second, first] = pairs[:, 2]
        norm = LogNorm(low, high)
        images.append(axes.imshow(square, cmap=colour_map("viridis"), norm=norm, interpolation="nearest"))
        axes.set(title=label if len(maps) == 2 else "", xlabel="antenna", ylabel="antenna")
        names = [f"{antenna:.0f}" for antenna in numbers[ticks]]
        axes.set_xticks(ticks, names)
        axes.set_yticks(ticks, names)
    for axes in panels[len(maps) :]:
        axes.set_visible(False)
    bar = figure.colorbar(images[0], ax=list(panels[: len(maps)]), label="reduced χ²", shrink=0.85, extend="both")
    steps = ticks_between(low, high)
    bar.set_ticks(steps, labels=[tick_label(step) for step in steps])
    bar.ax.minorticks_off()
    white = "are not in the data" if complete else "are not in the data or not among the most significant ones"
    return Drawing(
        "loop_baselines",
        "Which baselines carry the residual",
        f"Reduced χ² of the held-out visibilities of pairs of antennas. White pairs {white}.",
        "Square maps of reduced χ² over pairs of antennas.",
        figure,
    )


def _pairs(statistics: Entry | None) -> Array:
    """Return antennas and reduced χ² of every baseline, (N, 3)."""
    rows = [
        (*entry["what"], number(entry, "chi2"))
        for entry in axis_entries(statistics, "baselines")
        if isinstance(entry.get("what"), list) and len(entry["what"]) == 2
    ]
    return np.array([row for row in rows if math.isfinite(row[2])], dtype=float).reshape(-1, 3)
