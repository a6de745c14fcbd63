"""The test on data that the inference has not seen (HDBI II, section 4.3)."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure

LABELS = ("inferred beam, posterior predictive", "model beam, noise alone")
CAPTION = (
    "Real and imaginary parts of the held-out visibilities minus their prediction, over the predicted standard "
    "deviation: for the inferred beam with the posterior predictive mean and its standard deviation (noise and beam), "
    "for the model beam with the noise alone. A beam that predicts the data to the noise follows the dashed standard "
    "normal. Both panels show the same scores, on linear and on logarithmic scales."
)


def draw_heldout_scores(channel: Channel) -> Drawing | None:
    """Draw the z-scores of held-out visibilities for the inferred and the model beam."""
    edges, counts = channel.arrays.get("z_edges"), channel.arrays.get("z_counts")
    if edges is None or counts is None or not counts.any():
        return None
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2)
    for row, label, colour in zip(counts, LABELS, (INFERRED, MODEL), strict=True):
        coarse_edges, coarse = merge_bins(edges, row)
        for axes in (left, right):
            axes.stairs(
                coarse / row.sum() / np.diff(coarse_edges), coarse_edges, color=colour, linewidth=1.3, label=label
            )
    filled = np.flatnonzero(counts.any(axis=0))
    reach = 1.3 * max(-float(edges[filled[0]]), float(edges[filled[-1] + 1]), 5.0)
    z = np.sinh(np.linspace(-np.arcsinh(reach), np.arcsinh(reach), 1001))
    for axes in (left, right):
        axes.plot(
            z, np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi), "--", color=REFERENCE, linewidth=1, label="standard normal"
        )
        axes.grid()
    left.set(xlim=(-6, 6), ylim=(0, 0.48), xlabel="z of held-out visibilities", ylabel="density")
    right.set_xscale("asinh", linear_width=2.0)
    right.set(yscale="log", ylim=(0.1 / counts[0].sum() / reach**0.5, 2), xlim=(-reach, reach))
    right.set(xlabel="z of held-out visibilities (asinh scale)")
    candidates = (3, 10, 30, 100) if reach < 400 else (10, 100, 1000, 10_000, 100_000)[:: 1 if reach < 4e4 else 2]
    positive = [x for x in candidates if x < reach]
    ticks = [-x for x in positive[::-1]] + [0] + positive
    right.set_xticks(ticks, [f"{x:,}".replace("-", "−") for x in ticks])
    right.minorticks_off()
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return Drawing(
        "heldout_scores",
        "Held-out visibilities",
        CAPTION,
        "Histograms of held-out z-scores for the inferred and the model beam, with a standard normal.",
        figure,
    )


def merge_bins(edges: Array, counts: Array) -> tuple[Array, Array]:
    """Join neighbouring bins until those near zero hold enough counts to be smooth, or ten are joined.

    Returns
    -------
    edges, counts : ndarray, (Nbins + 1,) and (Nbins,)
    """
    middle = counts[len(counts) // 2 - 10 : len(counts) // 2 + 10].mean()
    step = next((step for step in (1, 2, 5) if step * middle >= 250), 10)
    starts = np.arange(0, len(counts), step)
    return np.append(edges[starts], edges[-1]), np.add.reduceat(counts, starts)
