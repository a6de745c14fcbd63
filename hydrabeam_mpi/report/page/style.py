"""How all figures look, and how they become files."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from PIL import Image

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.ticks import plain_ticks

# Colours of Okabe and Ito, told apart by colour-blind readers and in grey.
INFERRED = "#d55e00"
MODEL = "#0072b2"
UNCERTAINTY = "#e69f00"
REFERENCE = "#222222"
AZ_0 = "#009e73"
AZ_90 = "#7b3294"

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
    "pdf.fonttype": 42,
}
"""matplotlib settings, to be in force (``rc_context``) while figures are drawn and rendered."""

WIDTH = 7.6  # inches, of every figure
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


def new_figure(height: float) -> Figure:
    """Return an empty figure, ``height`` inches high, outside of pyplot's global state."""
    return Figure(figsize=(WIDTH, height), layout="constrained")


def colour_map(name: str) -> Colormap:
    """Return a colour map in 49 steps: finer than the eye reads off a bar, and small in a file."""
    return colormaps[name].resampled(49)


def decades(values: Array, low: float = 0.0) -> tuple[float, float]:
    """Return powers of ten that enclose the positive values from a percentile on; (0.1, 1) without any."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return 0.1, 1.0
    bottom, top = np.log10(np.percentile(positive, [low, 100]))
    return float(10 ** np.floor(bottom)), float(10 ** max(np.ceil(top), np.floor(bottom) + 1))


def render(figure: Figure) -> dict[str, bytes]:
    """Return a figure as "png" and as "pdf"; the same figure gives the same bytes at any time."""
    pixels, pages = BytesIO(), BytesIO()
    plain_ticks(figure)
    figure.savefig(pixels, format="rgba", dpi=DPI)
    figure.set_layout_engine("none")  # it is laid out; once is enough
    figure.savefig(pages, format="pdf", dpi=DPI, metadata={"CreationDate": None})
    width, height = (figure.get_size_inches() * DPI).astype(int).tolist()
    image = Image.frombytes("RGBA", (width, height), pixels.getvalue()).convert("RGB")
    return {"png": _as_small_png(image), "pdf": pages.getvalue()}


def _as_small_png(image: Image.Image) -> bytes:
    """Encode with a palette of 256 colours where nobody can see the difference, else in full colour."""
    palette = image.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    change = np.abs(np.asarray(palette.convert("RGB"), dtype=int) - np.asarray(image, dtype=int))
    buffer = BytesIO()
    (palette if np.mean(change > 16) < 1e-3 else image).save(buffer, format="png", optimize=True)
    return buffer.getvalue()
