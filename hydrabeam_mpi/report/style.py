"""How all figures look, and how they become files."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Colours of Okabe and Ito, told apart by colour-blind readers and in grey.
INFERRED = "#d55e00"
MODEL = "#0072b2"
UNCERTAINTY = "#e69f00"
REFERENCE = "#222222"
AZ_0 = "#009e73"
AZ_90 = "#7b3294"

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.use_mathtext": True,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
    "figure.facecolor": "white",
    "pdf.fonttype": 42,
}

DPI = 144


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure with what is said of it.

    Attributes
    ----------
    name : str
        Stem of its files.
    title : str
        A few words.
    caption : str
        How to read it, in plain text.
    alt : str
        What is to be seen, for those who cannot see it.
    figure : Figure
    """

    name: str
    title: str
    caption: str
    alt: str
    figure: Figure


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, size in inches, outside of pyplot's global state."""
    return Figure(figsize=(width, height), layout="constrained")


def render(figure: Figure, form: str) -> bytes:
    """Return a figure as ``form``, "png" or "pdf"; the same figure gives the same bytes at any time."""
    undated: dict[str, None] = {"CreationDate": None} if form == "pdf" else {"Software": None}
    buffer = BytesIO()
    figure.savefig(buffer, format=form, dpi=DPI, metadata=undated)
    return buffer.getvalue()


def light_grid(axes: Axes) -> None:
    """Draw faint lines at the major ticks of both axes."""
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def decades(values: np.ndarray, low: float = 0.0, high: float = 100.0) -> tuple[float, float]:
    """Return powers of ten that enclose the given percentiles of the positive values; (0.1, 1) without any."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return 0.1, 1.0
    bottom, top = np.log10(np.percentile(positive, [low, high]))
    return float(10 ** np.floor(bottom)), float(10 ** max(np.ceil(top), np.floor(bottom) + 1))
