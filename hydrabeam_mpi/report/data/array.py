"""The array: its antennas coloured by what is wrong with them, and the baselines that it has."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from scipy.constants import speed_of_light

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.report.page.result import Channel, Result
from hydrabeam_mpi.report.page.scales import tick_label, ticks_between
from hydrabeam_mpi.report.page.style import REFERENCE, Drawing, colour_map, new_figure
from hydrabeam_mpi.report.page.words import megahertz

FEW = 40  # antennas whose numbers have room
BELOW = 0.15  # of the height of a panel, which they take below the last antenna


def draw_array(result: Result, channel: Channel) -> Drawing | None:
    """Draw the antennas by chi^2 of their held-out baselines and by their gains, and the uv coverage."""
    told = result.observed
    if "antenna_positions" not in told:
        return None
    by_chi2, gains = _by_antenna(result, channel), _gains(result, channel)
    n_panels = 1 + (by_chi2 is not None) + (gains is not None)
    figure = new_figure(2.9 if n_panels == 3 else 3.6)
    # Bars have a row of their own, so that all panels stand side by side.
    panels, bars = figure.subplots(2, n_panels, squeeze=False, height_ratios=(1, 0.05))
    places = iter(zip(panels, bars, strict=True))
    text = []
    if by_chi2 is not None:
        low, high = float(np.nanmin(by_chi2, initial=1.0)), float(np.nanmax(by_chi2, initial=2.0))
        _draw_antennas(figure, *next(places), told, by_chi2, "reduced χ², held out", LogNorm(low, high), "viridis")
        text.append("the reduced χ² of their held-out baselines, after the inference, over the noise (noise alone: 1)")
    if gains is not None:
        spread = max(float(np.nanmax(np.abs(gains))), 0.1)
        norm = Normalize(-spread, spread)
        _draw_antennas(figure, *next(places), told, gains, "gain amplitude − 1 (%)", norm, "PuOr")
        text.append("the amplitude of their gains, given times found")
    coverage, no_bar = next(places)
    no_bar.set_axis_off()
    _draw_coverage(coverage, told, channel.freq)
    antennas = f"Antennas, coloured by {'; and by '.join(text)}. " if text else ""
    return Drawing(
        "array",
        "The array",
        f"{antennas}uv coverage at {megahertz(channel.freq)}: each redundant group of baselines with its reverse, the "
        f"larger the more baselines it has ({len(told['baseline_counts']):,} groups of "
        f"{int(told['baseline_counts'].sum()):,} baselines).",
        "Maps of the antennas, coloured, and the points of the uv plane that their baselines cover.",
        figure,
    )


def _by_antenna(result: Result, channel: Channel) -> FloatArray | None:
    """Return the reduced chi^2 after the inference of each antenna's baselines, (Nants,), NaN where it has none."""
    if "baseline_chi2" not in channel.arrays:
        return None
    numbers, counts = result.observed["antenna_numbers"], channel.arrays["baseline_n"]
    order = np.argsort(numbers)
    sums = np.zeros((2, len(numbers)))
    for antenna in result.observed["baselines"].T:
        places = order[np.searchsorted(numbers, antenna, sorter=order)]
        np.add.at(sums[0], places, counts)
        np.add.at(sums[1], places, counts * channel.arrays["baseline_chi2"][1])
    return np.divide(sums[1], sums[0], out=np.full(len(numbers), np.nan), where=sums[0] > 0)


def _gains(result: Result, channel: Channel) -> FloatArray | None:
    """Return gain amplitudes less one in percent, (Nants,); None where none were given nor found."""
    told: dict[str, Any] = result.numbers.get("gains") or {}
    numbers = result.observed["antenna_numbers"].tolist()
    if not told or told["antennas"] != numbers:
        return None
    parts = [told["channels"][channel.number].get(name) for name in ("given", "found")]
    ln_amplitudes = [np.array(part["ln_amplitude"], dtype=float) for part in parts if part]
    return 100 * np.expm1(np.sum(ln_amplitudes, axis=0)) if ln_amplitudes else None


def _draw_antennas(
    figure: Figure,
    axes: Axes,
    below: Axes,
    told: dict[str, Any],
    values: FloatArray,
    label: str,
    norm: Normalize,
    cmap: str,
) -> None:
    """Draw the antennas where they stand, (Nants,) values as colours, with the bar of these in the axes below."""
    east, north, _ = told["antenna_positions"].T
    n = len(east)
    size = float(np.clip(4000 / n, 4, 120))
    known = np.isfinite(values)
    axes.scatter(east[~known], north[~known], s=size, facecolors="none", edgecolors="0.6", linewidths=0.6)
    image = axes.scatter(
        east[known],
        north[known],
        s=size,
        c=values[known],
        cmap=colour_map(cmap),
        norm=norm,
        edgecolors="0.3",
        linewidths=0.4,
    )
    if n <= FEW:
        for number, x, y in zip(told["antenna_numbers"].tolist(), east, north, strict=True):
            axes.annotate(
                str(number), (x, y), (0, -0.5 * size**0.5 - 7), textcoords="offset points", ha="center", fontsize=6
            )
    bar = figure.colorbar(image, cax=below, orientation="horizontal", label=label)
    if isinstance(norm, LogNorm):
        ticks = ticks_between(float(norm.vmin or 1), float(norm.vmax or 2))[:: 2 if (norm.vmax or 2) > 1e3 else 1]
        bar.set_ticks(ticks, labels=[tick_label(tick) for tick in ticks])
        bar.ax.minorticks_off()
    axes.set(xlabel="East (m)", ylabel="North (m)", aspect="equal")
    axes.margins(0.12)
    if n <= FEW:  # the numbers stand below the antennas
        low, high = axes.get_ylim()
        axes.set_ylim(low - BELOW * (high - low), high)


def _draw_coverage(axes: Axes, told: dict[str, Any], freq: float) -> None:
    """Draw the baselines in wavelengths, with their reverses."""
    uv = told["baseline_vectors"][:, :2] * freq / speed_of_light
    counts = told["baseline_counts"] / told["baseline_counts"].max()
    sizes = np.clip(3000 / len(uv), 1, 30) * (0.3 + 0.7 * counts)
    for u, v in (uv.T, -uv.T):
        axes.scatter(u, v, s=sizes, color=REFERENCE, alpha=0.75, linewidths=0)
    axes.set(xlabel="u (wavelengths)", ylabel="v (wavelengths)", aspect="equal", title="")
    # As high as the panels of the antennas.
    axes.margins(0.12, 0.12 + 0.6 * BELOW * (len(told["antenna_numbers"]) <= FEW))
    axes.grid()
