"""The residual of every baseline, as a map over pairs of antennas."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm

from hydrabeam_mpi.report.data.sample import AFTER, BEFORE
from hydrabeam_mpi.report.page.result import Channel, Result
from hydrabeam_mpi.report.page.scales import tick_label, ticks_between
from hydrabeam_mpi.report.page.style import Drawing, colour_map, new_figure
from hydrabeam_mpi.report.page.words import megahertz


def draw_baselines(result: Result, channel: Channel) -> Drawing | None:
    """Draw reduced chi^2 of every pair of antennas, before and after; None where nothing was held out."""
    if "baseline_chi2" not in channel.arrays or not channel.arrays["baseline_n"].any():
        return None
    known = channel.arrays["baseline_n"] > 0
    pairs, chi2 = result.observed["baselines"][known], channel.arrays["baseline_chi2"][:, known]
    numbers = np.unique(pairs)
    low, high = float(np.percentile(chi2, 0.5)), float(np.percentile(chi2, 99.5))
    norm = LogNorm(max(min(low, 0.8), 0.1), max(high, 1.5))
    figure = new_figure(3.7)
    ticks = np.arange(0, len(numbers), -(-len(numbers) // 10))
    panels = figure.subplots(1, 2)
    one, two = np.searchsorted(numbers, pairs).T
    for axes, label, values in zip(panels, (BEFORE, AFTER), chi2, strict=True):
        square = np.full((len(numbers), len(numbers)), np.nan)
        square[one, two] = square[two, one] = values
        image = axes.imshow(square, cmap=colour_map("viridis"), norm=norm, interpolation="nearest")
        axes.set(title=label, xlabel="antenna", ylabel="antenna")
        axes.set_xticks(ticks, numbers[ticks])
        axes.set_yticks(ticks, numbers[ticks])
    bar = figure.colorbar(image, ax=list(panels), label="reduced χ²", shrink=0.85, extend="both")
    steps = ticks_between(float(norm.vmin or 0.1), float(norm.vmax or 1.5))
    bar.set_ticks(steps, labels=[tick_label(step) for step in steps])
    bar.ax.minorticks_off()
    return Drawing(
        "baselines",
        "Which baselines carry the residual",
        f"Reduced χ² over the noise of the held-out visibilities of all {len(pairs):,} pairs of antennas at "
        f"{megahertz(channel.freq)}, with the model beam and after the inference. White pairs are not in the data.",
        "Square maps of reduced χ² over pairs of antennas.",
        figure,
    )
