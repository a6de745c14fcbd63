"""Scales whose ticks are plain numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

STEPS = ((1, 2, 5), (1, 3), (1,))
MOST_TICKS = 6
LOGARITHMIC = 5.0  # ratio of the largest value to the smallest from which a scale is logarithmic
ROOM = 0.12  # beside the values, as a part of what they span: a line of labels has room above it


def ticks_between(low: float, high: float) -> list[float]:
    """Return round numbers between two positive ones, for a logarithmic scale: few, and evenly spread."""
    if high < LOGARITHMIC * low:
        steady = MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(low, high)
        return [float(tick) for tick in steady if low <= tick <= high]
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks: list[float] = []
    for steps in STEPS:
        ticks = [tick for power in powers for step in steps if low <= (tick := step * 10.0**power) <= high]
        if len(ticks) <= MOST_TICKS:
            return ticks
    return ticks[:: -(-len(ticks) // MOST_TICKS)]


def tick_label(value: float) -> str:
    """Write a round number: as it is, or as a power of ten where that has many digits."""
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:,.4g}".replace("-", "−")
    mantissa, exponent = f"{value:.0e}".split("e")
    factor = {"1": "", "-1": "-"}.get(mantissa, rf"{mantissa}\times ")
    return f"${factor}10^{{{int(exponent)}}}$"


def scale_values(axes: Axes, values: Sequence[float], room: float = ROOM) -> None:
    """Fit the y axis to values, logarithmic where they span a factor of five, with ``room`` for labels above them."""
    low, high = min(values), max(values)
    if low <= 0 or high < LOGARITHMIC * low:
        margin = room * max(high - low, 0.05 * abs(high), 1e-300)
        axes.set_ylim(low - margin, high + 1.5 * margin)
        return
    span = (high / low) ** room
    axes.set_yscale("log")
    axes.set_ylim(low / span, high * span**1.5)
    ticks = ticks_between(low / span, high * span**1.5)
    axes.set_yticks(ticks, [tick_label(tick) for tick in ticks])
    axes.minorticks_off()
