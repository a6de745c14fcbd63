"""Data, model and residual: against sidereal time for a few baselines, and of all of the sample as a waterfall."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.data.sample import AFTER, BEFORE, Sample
from hydrabeam_mpi.report.page.scales import tick_label, ticks_between
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, colour_map, new_figure
from hydrabeam_mpi.report.page.words import megahertz

MOST_ROWS = 10  # sidereal times beside a waterfall, evenly spread
COLOURS = {BEFORE: MODEL, AFTER: INFERRED}


def draw_visibilities(sample: Sample) -> Drawing | None:
    """Draw amplitude, phase and residual of the shortest, the worst predicted and the longest baseline."""
    chosen = _chosen(sample)
    if not chosen:
        return None
    figure = new_figure(5.8)
    grid = figure.subplots(3, len(chosen), sharex=True, sharey="row", squeeze=False)
    residuals, order = sample.residuals, np.argsort(sample.hours)
    hours = sample.hours[order]
    for column, baseline in zip(grid.T, chosen, strict=True):
        amplitude, phase, left = column
        amplitude.set_title(sample.name(baseline), fontsize=8.5)
        used = sample.used[order, baseline]
        for name, values in ((BEFORE, sample.before), (AFTER, sample.after)):
            one = np.where(used, values[order, baseline], np.nan)
            amplitude.plot(hours, np.abs(one), color=COLOURS[name], label=name)
            phase.plot(hours, np.rad2deg(np.angle(one)), ".", markersize=3, color=COLOURS[name])
            left.plot(hours, np.abs(residuals[name][order, baseline]), color=COLOURS[name], linewidth=0.9)
        data = np.where(used, sample.data[order, baseline], np.nan)
        amplitude.plot(hours, np.abs(data), "o", mfc="none", color=REFERENCE, markersize=3.5, mew=0.6, label="data")
        phase.plot(hours, np.rad2deg(np.angle(data)), "o", mfc="none", color=REFERENCE, markersize=3.5, mew=0.6)
        left.plot(hours, sample.noise[order, baseline], "--", color=REFERENCE, linewidth=0.9, label="noise")
        left.set(xlabel="LST (h)")
        left.xaxis.set_major_formatter(lambda lst, _: f"{lst % 24:.4g}")
        for axes in column:
            axes.grid()
    for axes, label in zip(grid[:, 0], ("amplitude (Jy)", "phase (deg)", "|residual| (Jy)"), strict=True):
        axes.set_ylabel(label)
    grid[0, 0].set_ylim(0)
    grid[1, 0].set(ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    grid[2, 0].set_yscale("log")
    handles = {label: handle for axes in (grid[0, 0], grid[2, 0]) for handle, label in zip(
        *axes.get_legend_handles_labels(), strict=True)}  # fmt: skip
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4)
    return Drawing(
        "visibilities",
        "Data, model and residual",
        f"Held-out visibilities of single baselines at {megahertz(sample.freq)} against local sidereal time: data "
        "(circles), the prediction with the model beam and nothing fitted (blue), and with all that was inferred "
        "(orange). Below, the size of what each leaves, with the standard deviation of the noise (dashed). The "
        "baselines are the shortest and the longest of the sample, and the one that is predicted worst.",
        f"Amplitude, phase and residual of {len(chosen)} baselines against sidereal time.",
        figure,
    )


def _chosen(sample: Sample) -> list[int]:
    """Choose the shortest baseline with data, the one with the largest reduced chi^2, and the longest."""
    counts = sample.used.sum(axis=0)
    known = np.flatnonzero(2 * counts > counts.max(initial=0))
    if not known.size:
        return []
    chi2 = np.nansum(np.abs(sample.residuals[AFTER]) ** 2 * sample.weights, axis=0) / np.maximum(counts, 1)
    worst = int(known[chi2[known].argmax()])
    return sorted({int(known[0]), worst, int(known[-1])})


def draw_waterfall(sample: Sample) -> Drawing | None:
    """Draw |residual| over the noise, time by baseline, before and after."""
    scores = {name: np.abs(left) / sample.noise for name, left in sample.residuals.items()}
    if not sample.used.any():
        return None
    order = np.argsort(sample.hours, kind="stable")
    largest = max(float(np.nanpercentile(one, 99.5)) for one in scores.values())
    norm = LogNorm(0.3, max(largest, 10.0))
    figure = new_figure(3.9)
    panels = figure.subplots(1, 2, sharey=True)
    cmap = colour_map("magma").with_extremes(bad="0.8")
    for axes, (name, one) in zip(panels, scores.items(), strict=True):
        image = axes.imshow(
            one[order], cmap=cmap, norm=norm, aspect="auto", origin="lower", interpolation="nearest"
        )  # fmt: skip
        axes.set(title=name, xlabel="baseline length (m)")
        _label(axes, sample, order)
    panels[0].set_ylabel("LST (h)")
    bar = figure.colorbar(image, ax=list(panels), label="|residual| / noise", extend="both", pad=0.02)
    ticks = ticks_between(float(norm.vmin or 0.3), float(norm.vmax or 10))
    bar.set_ticks(ticks, labels=[tick_label(tick) for tick in ticks])
    bar.ax.minorticks_off()
    return Drawing(
        "waterfall",
        "The residual over time and baselines",
        f"Size of the residual of held-out visibilities at {megahertz(sample.freq)} over the standard deviation of the "
        f"noise, for {sample.data.shape[1]} baselines in the order of their lengths, from the shortest to the longest: "
        "a column that stands out is a baseline (several, an antenna), a row a time. Noise alone is near 1, the dark "
        "end. Grey: no data.",
        "Two maps of the residual, time by baseline, before and after the inference.",
        figure,
    )


def _label(axes: Axes, sample: Sample, order: Array) -> None:
    """Write lengths under some of the baselines, and sidereal times beside some of the times."""
    n_times, n_bls = sample.data.shape
    columns = np.unique(np.linspace(0, n_bls - 1, 6).astype(int))
    lengths = np.linalg.norm(sample.vectors, axis=1)
    axes.set_xticks(columns, [f"{length:.0f}" for length in lengths[columns]])
    rows = np.arange(0, n_times, -(-n_times // MOST_ROWS))
    axes.set_yticks(rows, [f"{hours % 24:.1f}" for hours in sample.hours[order][rows]])
