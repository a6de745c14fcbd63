"""Which coefficients trade off against each other (HDBI II, section 4.1, eq. 25)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import Drawing, colour_map, new_figure

_STEP = 0.05  # of the colour scale
MOST_PIXELS = 1040
"""Of the picture's side, about what a figure has: a larger matrix is reduced to the strongest entry of each block."""


def draw_correlation(channel: Channel, covariance: Array) -> Drawing:
    """Draw the correlation matrix (real part), ordered by azimuthal number where the basis has one.

    Parameters
    ----------
    channel : Channel
    covariance : ndarray, (n, n)
        The channel's.
    """
    n = len(covariance)
    m = _azimuthal_numbers(channel, n)
    order = np.arange(n) if m is None else np.argsort(m, kind="stable")
    std = np.sqrt(np.diag(covariance).real)
    correlation = (covariance.real / np.outer(std, std))[np.ix_(order, order)]
    block = -(-n // MOST_PIXELS)
    figure = new_figure(6.7)
    axes = figure.subplots()
    norm = _colour_steps(correlation)
    end = block * (-(-n // block)) + 0.5
    image = axes.imshow(strongest(correlation, block), cmap=colour_map("RdBu_r"), norm=norm,
                        extent=(0.5, end, end, 0.5), interpolation="nearest")  # fmt: skip
    bar = figure.colorbar(image, ax=axes, shrink=0.85, aspect=32, pad=0.02, extendfrac=0.03)
    bar.set_label(f"correlation of coefficients{', real part' if channel.is_complex else ''}")
    ticks = np.arange(-10, 11) / 10
    bar.set_ticks(ticks[np.abs(ticks) <= norm.vmax].tolist())
    # Modes are numbered from one, as in the figure of the coefficients.
    axes.set(xlim=(0.5, n + 0.5), ylim=(n + 0.5, 0.5), xlabel="mode number", ylabel="mode number")
    axes.spines[["top", "right"]].set_visible(True)
    if m is not None:
        _mark_blocks(axes, m[order])
    return Drawing(
        "correlation",
        "Correlations",
        _caption(channel, m is not None, block, norm),
        f"Square matrix of correlations between coefficients{'' if m is None else ', in blocks of equal m'}.",
        figure,
    )


def _azimuthal_numbers(channel: Channel, n: int) -> Array | None:
    """Return m of every mode, or None for a basis without."""
    if channel.basis.get("kind") != "fourier_bessel" or len(channel.basis.get("modes", ())) != n:
        return None
    return np.array([m for _, m in channel.basis["modes"]])


def _colour_steps(correlation: Array) -> BoundaryNorm:
    """Return steps of colour, the middle one around zero, that end where one pair in a thousand lies beyond."""
    pairs = np.abs(correlation[np.triu_indices_from(correlation, 1)])
    beyond = float(np.quantile(pairs, 0.999)) if pairs.size else 0.0
    steps = np.clip(np.ceil(beyond / _STEP), 2, 19)
    return BoundaryNorm(_STEP * np.arange(-steps - 0.5, steps + 1), 49, extend="both")


def strongest(matrix: Array, block: int) -> Array:
    """Reduce a matrix, (n, n), to the entries of largest magnitude in blocks of ``block`` x ``block``."""
    if block == 1:
        return matrix
    n = -(-len(matrix) // block)
    padded = np.zeros((n * block, n * block))
    padded[: len(matrix), : len(matrix)] = matrix
    tiles = padded.reshape(n, block, n, block).swapaxes(1, 2).reshape(n, n, block * block)
    return np.take_along_axis(tiles, np.abs(tiles).argmax(axis=2)[..., np.newaxis], axis=2)[..., 0]


def _mark_blocks(axes: Axes, m: Array) -> None:
    """Draw lines where m changes, and label the blocks between which there is room."""
    values, starts, counts = np.unique(m, return_index=True, return_counts=True)
    axes.hlines(starts[1:] + 0.5, 0.5, len(m) + 0.5, color="0.3", linewidth=0.25)
    axes.vlines(starts[1:] + 0.5, 0.5, len(m) + 0.5, color="0.3", linewidth=0.25)
    centres = starts + (counts + 1) / 2
    labelled: list[int] = []
    for i in range(len(values)):
        if not labelled or centres[i] - centres[labelled[-1]] >= 0.026 * len(m):
            labelled.append(i)
    ticks, labels = centres[labelled].tolist(), [f"{value:d}".replace("-", "−") for value in values[labelled]]
    axes.set_xticks(ticks, labels, fontsize=7, rotation=90)
    axes.set_yticks(ticks, labels, fontsize=7)
    axes.tick_params(length=2)
    axes.set(xlabel="azimuthal number m", ylabel="azimuthal number m")


def _caption(channel: Channel, by_m: bool, block: int, norm: BoundaryNorm) -> str:
    text = f"{'Real part of the correlations' if channel.is_complex else 'Correlations'} between coefficients. "
    if by_m:
        text += (
            "Modes are ordered by azimuthal number m, and within each m as in the basis; lines mark where m changes. "
        )
        text += "" if channel.is_complex else "Negative m are sines, the others cosines. "
    if "correlation_below_0.1" in channel.numbers and "correlation_max_real" in channel.numbers:
        below, largest = (channel.numbers[key] for key in ("correlation_below_0.1", "correlation_max_real"))
        text += f"Of all pairs {100 * below:.1f}% lie below 0.1 in absolute value; the largest is {largest:.2f}. "
    text += f"Colours end at ±{norm.vmax:.3f}, so that weaker structure shows. "
    if block > 1:
        text += f"Each pixel shows the strongest of {block} × {block} entries."
    return text.strip()
