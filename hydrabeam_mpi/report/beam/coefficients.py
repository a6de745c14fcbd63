"""What the data did to each coefficient (HDBI II, section 4.1, eq. 23)."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, UNCERTAINTY, Drawing, decades, new_figure


def draw_coefficients(channel: Channel) -> Drawing:
    """Draw |MAP|, posterior and prior standard deviation of every mode, and the update in posterior sigmas."""
    mean, std, prior_mean, prior_std = (channel.arrays[key] for key in ("mean", "std", "prior_mean", "prior_std"))
    size, update = np.abs(mean), np.abs(mean - prior_mean) / std
    number = np.arange(1, len(mean) + 1)
    figure = new_figure(5.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    top.plot(number, size, ".", color=INFERRED, markersize=3, label="|MAP|")
    if np.isfinite(prior_std).any():
        top.plot(number, prior_std, ":", color=REFERENCE, linewidth=1, label="prior standard deviation")
    top.plot(number, std, color=UNCERTAINTY, linewidth=1.3, label="posterior standard deviation")
    top.set(yscale="log", ylabel="coefficient", ylim=decades(np.concatenate([size, std]), 0.5))
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    bottom.plot(number, update, ".", color=MODEL, markersize=3)
    for level in (1, 10):
        bottom.axhline(level, color=REFERENCE, linewidth=0.7, linestyle="--")
    bottom.set(yscale="log", ylabel=r"$|z_{\rm update}|$", ylim=(decades(update, 2)[0], max(decades(update)[1], 20)))
    bottom.set(xlabel=f"mode number{_order(np.abs(prior_mean))}", xlim=(0, len(mean) + 1))
    for axes in (top, bottom):
        axes.grid()
    return Drawing(
        "coefficients",
        "Coefficients",
        _caption(std, prior_std, update),
        "Two panels against mode number: sizes and standard deviations of the coefficients, and how many posterior "
        "standard deviations each was moved by the data.",
        figure,
    )


def _order(size: Array) -> str:
    """Say so where modes are sorted by amplitude, which a refit changes a little."""
    rank = np.argsort(np.argsort(-size))
    in_order = len(size) > 2 and np.corrcoef(rank, np.arange(len(size)))[0, 1] > 0.9
    return ", the largest of the model beam first" if in_order else ""


def _caption(std: Array, prior_std: Array, update: Array) -> str:
    if np.isfinite(prior_std).any():
        halved = np.count_nonzero(std < 0.5 * prior_std)
        text = (
            "Top: amplitude of the most probable (MAP) coefficients, their posterior and prior standard deviations: "
            "where the posterior lies far below the prior, the data decide; where they meet, the prior does. The data "
            f"more than halve the uncertainty of {halved:,} of the {len(std):,} coefficients. "
        )
    else:
        text = (
            "Top: amplitude of the most probable (MAP) coefficients with their posterior standard deviations; the "
            "prior is flat. "
        )
    return text + (
        "Bottom: z_update, the distance between MAP and prior mean in posterior standard deviations; "
        f"{np.count_nonzero(update > 10):,} modes are moved by more than 10σ (upper dashed line; the lower is 1σ)."
    )
