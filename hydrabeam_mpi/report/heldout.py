"""The test on data that the inference has not seen (HDBI II, section 4.3), and key numbers against frequency."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.report.result import Channel
from hydrabeam_mpi.report.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure

Array = NDArray


def draw_heldout_scores(channel: Channel) -> Drawing | None:
    """Draw the z-scores of held-out visibilities for the inferred and the model beam."""
    if "z_counts" not in channel.arrays or not channel.arrays["z_counts"].any():
        return None
    edges, counts = channel.arrays["z_edges"], channel.arrays["z_counts"]
    edges, counts = _merge_bins(edges, counts)
    density = counts / counts.sum(axis=1, keepdims=True) / np.diff(edges)
    figure = new_figure(3.5)
    left, right = figure.subplots(1, 2)
    reach = float(np.abs(edges[np.flatnonzero(counts.any(axis=0))]).max()) * 1.3
    z = np.sinh(np.linspace(-np.arcsinh(reach), np.arcsinh(reach), 1001))
    normal = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    for axes in (left, right):
        axes.stairs(density[1], edges, color=MODEL, linewidth=1.3, label="model beam, noise alone")
        axes.stairs(density[0], edges, color=INFERRED, linewidth=1.3, label="inferred beam, posterior predictive")
        axes.plot(z, normal, "--", color=REFERENCE, linewidth=1, label="standard normal")
        axes.grid()
    left.set(xlim=(-6, 6), ylim=(0, 0.48), xlabel="z of held-out visibilities", ylabel="density")
    right.set_xscale("asinh", linear_width=2.0)
    floor = 0.3 / float(counts.sum(axis=1).max()) / float(np.diff(edges).max(initial=1.0, where=counts.any(axis=0)))
    right.set(yscale="log", ylim=(floor, 2), xlim=(-reach, reach), xlabel="z (asinh scale)")
    right.set_xticks(_score_ticks(reach))
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    caption = (
        "Real and imaginary parts of the held-out visibilities minus their prediction, over the predicted standard "
        "deviation: for the inferred beam with the posterior predictive mean and its standard deviation (noise and "
        "beam), for the model beam with the noise alone. A beam that predicts the data to the noise follows the "
        "dashed standard normal. Both panels show the same histograms, on linear and on logarithmic scales."
    )
    return Drawing("heldout_scores", "Held-out visibilities", caption,
                   "Histograms of held-out z-scores: narrow for the inferred beam, wide for the model beam, with a "
                   "standard normal.", figure)  # fmt: skip


def _merge_bins(edges: Array, counts: Array) -> tuple[Array, Array]:
    """Join neighbouring bins until the middle ones hold enough to be smooth."""
    centre = np.diff(edges)[len(edges) // 2] * counts[0].sum() / 3  # expected near z = 0
    step = next((step for step in (1, 2, 4) if step * centre > 200), 5)
    starts = np.arange(0, counts.shape[1], step)
    return np.append(edges[:-1][starts], edges[-1]), np.add.reduceat(counts, starts, axis=1)


def _score_ticks(reach: float) -> list[float]:
    positive = [x for x in (3.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e5) if x < reach]
    return [-x for x in positive[::-1]] + [0.0] + positive


def draw_frequencies(channels: list[Channel]) -> Drawing | None:
    """Draw key numbers against frequency; None for a single channel."""
    if len(channels) < 2:
        return None
    wanted = [
        ("held-out reduced χ²", {"heldout_chi2_unperturbed": "model beam", "heldout_chi2": "inferred beam"}),
        ("held-out z: std", {"ppd_z_std_unperturbed": "model beam", "ppd_z_std": "inferred beam"}),
        ("beam, largest difference", {"model_error_max": "truth − model", "beam_error_max": "truth − MAP",
                                      "beam_update_max": "MAP − model"}),  # fmt: skip
        ("posterior std of a coefficient", {"posterior_std_median": "median"}),
        ("condition number", {"condition_number": "of the covariance"}),
        ("negative fraction of the map", {"negative_fraction": "real part below 0"}),
    ]
    freqs = np.array([channel.freq for channel in channels]) / 1e6
    panels = []
    for label, keys in wanted:
        lines = {name: np.array([c.numbers.get(key, np.nan) for c in channels], float) for key, name in keys.items()}
        lines = {name: values for name, values in lines.items() if np.isfinite(values).any()}
        if lines:
            panels.append((label, lines))
    if not panels:
        return None
    figure = new_figure(1.9 * -(-len(panels) // 2) + 0.3)
    grid = figure.subplots(-(-len(panels) // 2), 2, sharex=True, squeeze=False).ravel()
    for axes, (label, lines) in zip(grid, panels, strict=False):
        for (name, values), colour in zip(lines.items(), (MODEL, INFERRED, REFERENCE), strict=False):
            axes.plot(freqs, values, "o-", markersize=3, color=colour if len(lines) > 1 else REFERENCE, label=name)
        positive = all((values[np.isfinite(values)] > 0).all() for values in lines.values())
        axes.set(title=label, yscale="log" if positive else "linear")
        if len(lines) > 1:
            axes.legend(fontsize=7.5)
        axes.grid()
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[max(len(panels) - 2, 0) : len(panels)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("frequency (MHz)")
    return Drawing("frequencies", "All channels", "Key numbers of every channel, each inferred by itself.",
                   "Small panels with key numbers against frequency.", figure)  # fmt: skip
