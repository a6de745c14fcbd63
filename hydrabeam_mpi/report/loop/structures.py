"""The largest structures of the residual that no effect explains: singular values, and patterns in time and space."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.loop.record import Entry, entries, number, sigmas
from hydrabeam_mpi.report.page.key_numbers import format_value
from hydrabeam_mpi.report.page.scales import scale_values
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, UNCERTAINTY, Drawing, colour_map, new_figure

STRONGEST = 10  # antennas and baselines that are drawn
EDGES = {
    "expected_noise": ("largest of noise alone, mean ± 3 std", MODEL),
    "noise_of_this_rms": ("largest of noise as strong as the residual", UNCERTAINTY),
}


def draw_singular_values(structures: Entry | None) -> Drawing | None:
    """Draw the singular values of the residual against the largest one that noise has."""
    values = [value for value in (structures or {}).get("singular_values") or [] if isinstance(value, int | float)]
    if not values:
        return None
    figure = new_figure(2.6)
    axes = figure.subplots()
    heights = list(values)
    for key, (label, colour) in EDGES.items():
        edge = ((structures or {}).get("edge") or {}).get(key)
        mean, spread = number(edge, "mean"), np.nan_to_num(number(edge, "std"))
        if math.isfinite(mean):
            axes.axhspan(mean - 3 * spread, mean + 3 * spread, color=colour, alpha=0.3, linewidth=0)
            axes.axhline(mean, color=colour, linewidth=1, linestyle="--", label=label)
            heights.append(mean)
    axes.plot(range(1, len(values) + 1), values, "o", color=INFERRED, markersize=5, label="residual")
    scale_values(axes, heights)
    axes.set_xticks(range(1, len(values) + 1))
    axes.set(xlabel="structure", ylabel="singular value")
    axes.grid(axis="y")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return Drawing(
        "loop_singular_values",
        "How many structures the residual has",
        "Singular values of the matrix of whitened held-out residuals, baselines by times and channels, largest first. "
        "What is above the blue band is no noise of the assumed level; what is above the orange one has a shape of its "
        "own, even if the noise were underestimated.",
        f"{len(values)} singular values against the edge of the noise's.",
        figure,
    )


def draw_structures(structures: Entry | None) -> Drawing | None:
    """Draw the largest structures, a row each: their pattern over time and frequency, their antennas and baselines."""
    shown = [one for one in entries(structures, "structures") if _pattern(one) is not None]
    if not shown:
        return None
    figure = new_figure(2.45 * len(shown) + 0.1)
    rows = figure.subfigures(len(shown), 1, squeeze=False)[:, 0]
    for count, (one, row) in enumerate(zip(shown, rows, strict=True), 1):
        share, sigma = number(one, "share"), number(one, "sigma")
        words = [f"Structure {count}"]
        words += [f"{format_value(share, 'percent')} of the residual"] if math.isfinite(share) else []
        words += [f"{sigmas(sigma)}σ above noise"] if math.isfinite(sigma) else []
        row.suptitle(", ".join(words), fontsize=9, x=0.01, ha="left")
        pattern, antennas, baselines = row.subplots(1, 3, width_ratios=(2.2, 1, 1))
        _draw_pattern(row, pattern, one["pattern"])
        _draw_shares(antennas, entries(one, "antennas"), "antenna")
        _draw_shares(baselines, entries(one, "baselines"), "baseline")
    return Drawing(
        "loop_structures",
        "The largest structures of the residual",
        "Singular vectors of the whitened held-out residuals. Left: the pattern over time and frequency that the "
        "baselines share, its phase such that the largest value is positive. Right: the share of each antenna and of "
        f"each baseline in it, the {STRONGEST} largest.",
        f"{len(shown)} rows with a pattern and bars of shares.",
        figure,
    )


def _pattern(one: Entry) -> Array | None:
    """Return a pattern, (Nfreqs, Ntimes) complex; None where it is not given in full."""
    given = one.get("pattern") or {}
    real, imag = np.asarray(given.get("real") or 0.0), np.asarray(given.get("imag") or 0.0)
    shape = (len(given.get("freqs_hz") or []), len(given.get("jds") or given.get("lsts_h") or []))
    return real + 1j * imag if real.shape == imag.shape == shape and real.size else None


def _times(given: Entry) -> tuple[Array, str]:
    """Return an ascending time axis with its label: LST, hours, or for several days the order alone."""
    lsts, jds = np.asarray(given.get("lsts_h") or []), np.asarray(given.get("jds") or [])
    if len(lsts) and np.all(np.diff(lsts) > 0):
        return lsts, "LST (h)"
    if len(jds) and np.ptp(jds) < 1 and np.all(np.diff(jds) > 0):
        return 24 * (jds - jds[0]), f"hours since JD {jds[0]:.2f}"
    return np.arange(max(len(lsts), len(jds))), "held-out time, in order"


def _draw_pattern(row: Any, axes: Axes, given: Entry) -> None:
    pattern = _pattern({"pattern": given})
    assert pattern is not None
    times, label = _times(given)
    freqs = np.asarray(given["freqs_hz"]) / 1e6
    if 1 in pattern.shape:
        over_time = pattern.shape[0] == 1
        place, line = (times, pattern[0]) if over_time else (freqs, pattern[:, 0])
        axes.axhline(0, color="0.4", linewidth=0.7)
        axes.plot(place, line.real, "o-", markersize=2.5, color=INFERRED, linewidth=0.8, label="real")
        axes.plot(place, line.imag, "o-", markersize=2.5, color=MODEL, linewidth=0.8, label="imaginary")
        axes.set(xlabel=label if over_time else "frequency (MHz)", ylabel="pattern")
        axes.legend(fontsize=7, ncols=2, loc="upper right", handlelength=1.2)
        axes.margins(y=0.25)
        axes.grid()
        return
    limit = float(np.abs(pattern).max()) or 1.0
    edges = _edges(times), _edges(freqs)
    image = axes.pcolormesh(*edges, pattern.real, cmap=colour_map("RdBu_r"), vmin=-limit, vmax=limit, rasterized=True)
    axes.set(xlabel=label, ylabel="frequency (MHz)")
    figure: Figure = row
    figure.colorbar(image, ax=axes, label="real part", pad=0.02)


def _edges(middles: Array) -> Array:
    """Return edges of cells about their middles."""
    between = (middles[1:] + middles[:-1]) / 2
    return np.concatenate([[2 * middles[0] - between[0]], between, [2 * middles[-1] - between[-1]]])


def _draw_shares(axes: Axes, shares: list[Entry], what: str) -> None:
    named = [(entry["what"], number(entry, "share")) for entry in shares[:STRONGEST] if "what" in entry]
    if not named:
        axes.set_visible(False)
        return
    labels = ["–".join(map(str, name)) if isinstance(name, list) else str(name) for name, _ in named]
    axes.barh(range(len(named)), [share for _, share in named], height=0.7, color=REFERENCE, alpha=0.75)
    axes.set_yticks(range(len(named)), labels, fontsize=7)
    axes.set(ylim=(STRONGEST - 0.4, -0.6), xlabel="share", title=what, xlim=(0, None))
    axes.tick_params(left=False)
