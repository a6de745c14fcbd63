"""Key numbers of all channels against frequency."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import NullFormatter

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure

PANELS = {
    "held-out reduced χ² over the noise": {
        "heldout_chi2_unperturbed": "model beam",
        "heldout_chi2_noise_only": "inferred beam",
        "heldout_chi2_predictive": "inferred beam, predictive",
    },
    "largest beam error": {"model_error_max": "model beam", "beam_error_max": "inferred beam"},
    "largest change from the model beam": {"beam_update_max": "|MAP − model|"},
    "median posterior std of a coefficient": {"posterior_std_median": "std"},
    "condition number of the covariance": {"condition_number": "number"},
    "fraction of the map below zero": {"negative_fraction": "fraction"},
}
COLOURS = {"model beam": MODEL, "inferred beam": INFERRED}


def draw_frequencies(channels: list[Channel], together: str = "") -> Drawing | None:
    """Draw the key numbers against frequency; None for a single channel.

    ``together`` says how the channels hang together, where they do.
    """
    known = {title: lines for title, keys in PANELS.items() if (lines := _lines(channels, keys))}
    if len(channels) < 2 or not known:
        return None
    freqs = np.array([channel.freq for channel in channels]) / 1e6
    rows = -(-len(known) // 2)
    figure = new_figure(1.75 * rows + 0.4)
    grid = figure.subplots(rows, 2, squeeze=False).ravel()
    for axes, (title, lines) in zip(grid, known.items(), strict=False):
        for name, values in lines.items():
            axes.plot(freqs, values, "o-", markersize=3, color=COLOURS.get(name, REFERENCE), label=name)
        axes.set(title=title)
        axes.locator_params(axis="x", nbins=5)
        low, high = np.nanmin([*lines.values()]), np.nanmax([*lines.values()])
        if 0 < 10 * low < high:
            axes.set_yscale("log")
            axes.yaxis.set_minor_formatter(NullFormatter())
        if len(lines) > 1:
            axes.legend(fontsize=7.5)
        axes.grid()
    for axes in grid[max(len(known) - 2, 0) : len(known)]:
        axes.set_xlabel("frequency (MHz)")
    for axes in grid[len(known) :]:
        axes.set_visible(False)
    return Drawing(
        "frequencies",
        "All channels",
        "Key numbers of every channel"
        + (f".{together}" if together else "; each was inferred from its own visibilities, without the others."),
        f"{len(known)} small panels with key numbers against frequency.",
        figure,
    )


def _lines(channels: list[Channel], keys: dict[str, str]) -> dict[str, Array]:
    """Return the named numbers of all channels, NaN where one has none; those that no channel has are left out."""
    lines = {name: np.array([c.numbers.get(key, np.nan) for c in channels], dtype=float) for key, name in keys.items()}
    return {name: values for name, values in lines.items() if np.isfinite(values).any()}
