"""The posterior in the space of coefficients: updates, correlations, eigenbeams (HDBI II, section 4.1)."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.linalg import eigvalsh

from hydrabeam_mpi.report.projection import VIEW, draw_disc, to_disc
from hydrabeam_mpi.report.result import Channel
from hydrabeam_mpi.report.style import (
    INFERRED,
    MODEL,
    REFERENCE,
    UNCERTAINTY,
    Drawing,
    decades,
    light_grid,
    new_figure,
)

Array = NDArray


def draw_coefficients(channel: Channel) -> Drawing:
    """Draw |MAP|, posterior and prior standard deviation of every mode, and the update in posterior sigmas."""
    mean, std, prior_mean, prior_std = (channel.arrays[key] for key in ("mean", "std", "prior_mean", "prior_std"))
    update = np.abs(mean - prior_mean) / std
    number = np.arange(1, len(mean) + 1)
    figure = new_figure(7.6, 5.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    top.plot(number, np.abs(mean), ".", color=INFERRED, markersize=3, label="|MAP|")
    if np.isfinite(prior_std).any():
        top.plot(number, prior_std, ":", color=REFERENCE, linewidth=1, label="prior standard deviation")
    top.plot(number, std, color=UNCERTAINTY, linewidth=1.3, label="posterior standard deviation")
    top.set(yscale="log", ylabel="coefficient", ylim=_room(np.concatenate([np.abs(mean), std])))
    top.legend(loc="upper right", ncols=3)
    bottom.plot(number, update, ".", color=MODEL, markersize=3)
    for level in (1, 10):
        bottom.axhline(level, color=REFERENCE, linewidth=0.7, linestyle="--")
    bottom.set(yscale="log", ylabel="|z_update|", ylim=(max(decades(update, 2)[0], 1e-3), decades(update)[1]))
    bottom.set(xlabel=f"mode number{_order(prior_mean)}", xlim=(0, len(mean) + 1))
    for axes in (top, bottom):
        light_grid(axes)
    return Drawing("coefficients", "Coefficients", _coefficient_caption(std, prior_std, update),
                   "Two panels against mode number: sizes and standard deviations of the coefficients, and how many "
                   "posterior standard deviations each was moved.", figure)  # fmt: skip


def _room(values: Array) -> tuple[float, float]:
    """Limits of a logarithmic axis with room above for a legend."""
    bottom, top = decades(values, 0.5)
    return bottom, top * 4


def _order(prior_mean: Array) -> str:
    """Say so where modes stand in the order of their size."""
    size = np.abs(prior_mean)
    return ", by falling size in the model beam" if len(size) > 1 and np.all(np.diff(size) <= 0) else ""


def _coefficient_caption(std: Array, prior_std: Array, update: Array) -> str:
    text = (
        "Top: amplitude of the most probable (MAP) coefficients with their posterior and prior standard deviations. "
        "Where the posterior lies far below the prior, the data decide; where they meet, the prior does. "
    )
    if np.isfinite(prior_std).any():
        halved = np.count_nonzero(std < 0.5 * prior_std)
        text += f"The data more than halve the uncertainty of {halved:,} of the {len(std):,} coefficients. "
    return text + (
        "Bottom: distance between MAP and prior mean in posterior standard deviations, z_update; "
        f"{np.count_nonzero(update > 10):,} modes are moved by more than 10σ (upper dashed line)."
    )


def draw_correlation(channel: Channel, covariance: Array, largest: int = 1040) -> Drawing:
    """Draw the correlation matrix (real part), ordered by azimuthal number where the basis has one.

    Parameters
    ----------
    channel : Channel
    covariance : ndarray, (n, n)
        The channel's.
    largest : int
        Pixels of the picture's side; a larger matrix is reduced to the entry of largest magnitude in each block.
    """
    std = np.sqrt(np.diag(covariance).real)
    m = _azimuthal_numbers(channel)
    order = np.argsort(m, kind="stable")
    correlation = (covariance.real / np.outer(std, std))[np.ix_(order, order)]
    off_diagonal = np.abs(correlation[np.triu_indices_from(correlation, 1)])
    limit = 0.1 if not off_diagonal.size else float(np.clip(np.ceil(np.quantile(off_diagonal, 0.999) * 20) / 20, 0.1, 1))
    block = -(-len(std) // largest)
    picture = _strongest(correlation, block)
    figure = new_figure(7.6, 6.7)
    axes = figure.subplots()
    levels = np.linspace(-limit, limit, 18)
    extent = (-0.5, block * len(picture) - 0.5, block * len(picture) - 0.5, -0.5)
    image = axes.imshow(picture, cmap=colormaps["RdBu_r"], norm=BoundaryNorm(levels, 256), extent=extent,
                        interpolation="nearest")  # fmt: skip
    part = "Re ρ" if channel.is_complex else "ρ"
    bar = figure.colorbar(image, ax=axes, shrink=0.85, aspect=32, pad=0.02, extend="both", extendfrac=0.03)
    bar.set_label(f"correlation of coefficients, {part}")
    bar.set_ticks(np.linspace(-limit, limit, 5).tolist(), labels=[f"{x:.2g}" for x in np.linspace(-limit, limit, 5)])
    bar.ax.minorticks_off()
    axes.set(xlim=(-0.5, len(std) - 0.5), ylim=(len(std) - 0.5, -0.5))
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    by_m = bool(m.any())
    if by_m:
        _mark_blocks(axes, m[order])
    else:
        axes.set(xlabel="mode number", ylabel="mode number")
    return Drawing("correlation", "Correlations", _correlation_caption(off_diagonal, limit, by_m, block, channel),
                   "Square matrix of correlations between coefficients, nearly white except near its diagonal"
                   + (" in blocks of equal azimuthal number." if by_m else "."), figure)  # fmt: skip


def _azimuthal_numbers(channel: Channel) -> Array:
    """Return m of every mode; zeros where the basis has none."""
    modes = channel.basis.get("modes") if channel.basis.get("kind") == "fourier_bessel" else None
    n_modes = len(channel.arrays["mean"])
    return np.zeros(n_modes, dtype=int) if modes is None else np.array([m for _, m in modes])


def _strongest(matrix: Array, block: int) -> Array:
    """Reduce a matrix to the entries of largest magnitude in blocks of ``block`` x ``block``."""
    if block == 1:
        return matrix
    n = -(-len(matrix) // block)
    padded = np.zeros((n * block, n * block))
    padded[: len(matrix), : len(matrix)] = matrix
    tiles = padded.reshape(n, block, n, block).swapaxes(1, 2).reshape(n, n, block * block)
    return np.take_along_axis(tiles, np.abs(tiles).argmax(axis=2)[..., None], axis=2)[..., 0]


def _mark_blocks(axes: Axes, m: Array) -> None:
    """Draw lines where m changes, and label the blocks that are wide enough."""
    values, starts, counts = np.unique(m, return_index=True, return_counts=True)
    for edge in starts[1:]:
        axes.axhline(edge - 0.5, color="black", linewidth=0.35, alpha=0.7)
        axes.axvline(edge - 0.5, color="black", linewidth=0.35, alpha=0.7)
    centres = starts + (counts - 1) / 2
    labelled = [0] if len(values) else []
    for i in range(1, len(values)):
        if centres[i] - centres[labelled[-1]] >= 0.026 * len(m):
            labelled.append(i)
    ticks, labels = centres[labelled].tolist(), [f"{value:d}" for value in values[labelled]]
    axes.set_xticks(ticks, labels, fontsize=7, rotation=90)
    axes.set_yticks(ticks, labels, fontsize=7)
    axes.tick_params(length=2)
    axes.set(xlabel="azimuthal number m", ylabel="azimuthal number m")


def _correlation_caption(off_diagonal: Array, limit: float, by_m: bool, block: int, channel: Channel) -> str:
    text = f"{'Real part of the correlation' if channel.is_complex else 'Correlation'} between coefficients. "
    if by_m:
        text += "Modes are ordered by azimuthal number m, and by size within each m; lines mark where m changes. "
        if not channel.is_complex:
            text += "Negative m are the sines, positive m the cosines. "
    if off_diagonal.size:
        text += (
            f"Of all pairs, {100 * np.mean(off_diagonal < 0.1):.1f}% lie below 0.1 in absolute value; the largest "
            f"is {off_diagonal.max():.2f}. Colours end at ±{limit:.2g}, so that weaker structure shows. "
        )
    if block > 1:
        text += f"Each pixel shows the strongest of {block} × {block} entries."
    return text.strip()


def draw_eigenbeams(channel: Channel, covariance: Array) -> Drawing | None:
    """Draw the best-constrained eigenvectors of the covariance on the sky, and all its eigenvalues."""
    if "eigen_beams" not in channel.arrays:
        return None
    beams = np.array([_with_real_peak(beam) for beam in channel.arrays["eigen_beams"]])
    parts = [("Re", beams.real)] + ([("Im", beams.imag)] if np.iscomplexobj(beams) else [])
    variances = eigvalsh(covariance, check_finite=False)
    figure = new_figure(7.6, 2.2 * len(parts) + 2.4)
    rows = figure.subfigures(2, 1, height_ratios=[2.2 * len(parts), 2.3])
    grid = np.atleast_2d(rows[0].subplots(len(parts), len(beams), squeeze=False))
    for (label, values), row in zip(parts, grid, strict=True):
        for number, (axes, value) in enumerate(zip(row, values, strict=True)):
            scale = float(np.abs(beams[number]).max()) or 1.0
            square = to_disc(value / scale, channel.za, channel.az)
            image = draw_disc(axes, square, colormaps["RdBu_r"], Normalize(-1, 1), ink="0.4")
            if label == "Re":
                deviation = _power_of_ten(np.sqrt(channel.arrays["eigen_variances"][number]))
                axes.set_title(f"{number + 1}: σ = {deviation}", fontsize=8.5)
        row[0].set_ylabel(f"{label} part" if len(parts) == 2 else "")
    rows[0].colorbar(image, ax=grid, shrink=0.7, aspect=24, pad=0.02).set_label("eigenbeam / its peak")
    _draw_spectrum(rows[1], variances)
    condition = variances[-1] / variances[0]
    caption = (
        "Top: the combinations of modes that the data determine best, that is the eigenvectors of the posterior "
        f"covariance with the smallest eigenvalues, seen on the sky{' (phase chosen real at the peak)' if len(parts) == 2 else ''}; "
        "σ is the standard deviation along each. They resemble fringes of the most redundant baselines, or the "
        f"array's point-spread function: what the array measures directly. {VIEW} Bottom: standard deviation along "
        f"all {len(variances):,} eigenvectors. The condition number of the covariance, the ratio of its extreme "
        f"eigenvalues, is {condition:,.0f}: modes trade off {'mildly' if condition < 1e6 else 'strongly'}."
    )
    return Drawing("eigenbeams", "Eigenbeams", caption,
                   "Maps of the best-constrained eigenvectors of the covariance: fringe-like patterns; below, the "
                   "spectrum of eigenvalues.", figure)  # fmt: skip


def _with_real_peak(beam: Array) -> Array:
    """Turn an eigenvector's free phase (or sign) so that its largest value is real and positive."""
    peak = beam.ravel()[np.abs(beam).argmax()]
    return beam * (np.conj(peak) / np.abs(peak)) if peak else beam


def _power_of_ten(value: float) -> str:
    mantissa, exponent = f"{value:.2e}".split("e")
    return rf"${mantissa}\times10^{{{int(exponent)}}}$"


def _draw_spectrum(figure: Figure, variances: Array) -> None:
    axes = figure.subplots()
    axes.plot(np.arange(1, len(variances) + 1), np.sqrt(np.abs(variances)), color=UNCERTAINTY)
    axes.set(yscale="log", xlabel="eigenvector, best constrained first", ylabel="posterior std along it",
             xlim=(0, len(variances) + 1))  # fmt: skip
    light_grid(axes)
