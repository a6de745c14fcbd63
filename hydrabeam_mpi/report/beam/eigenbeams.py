"""What the data determine best (HDBI II, section 4.1): eigenvectors of the posterior covariance on the sky."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import SubFigure
from matplotlib.image import AxesImage
from matplotlib.layout_engine import ConstrainedLayoutEngine
from scipy.linalg import eigvalsh

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.key_numbers import format_value
from hydrabeam_mpi.report.page.projection import add_colorbar, draw_disc, to_disc
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import UNCERTAINTY, Drawing, new_figure


def draw_eigenbeams(channel: Channel, covariance: Array) -> Drawing | None:
    """Draw the best-constrained eigenvectors of a covariance, (n, n), on the sky, and the spectrum of eigenvalues."""
    if "eigen_beams" not in channel.arrays:
        return None
    parts = 2 if channel.is_complex else 1
    figure = new_figure(1.8 * parts + 2.3)
    halves: Any = figure.subfigures(2, 1, height_ratios=[1.8 * parts + 0.1, 2.0])
    maps, spectrum = halves
    _draw_beams(maps, channel, parts)
    variances = eigvalsh(covariance, check_finite=False)
    axes = spectrum.subplots()
    axes.plot(np.arange(1, len(variances) + 1), np.sqrt(np.abs(variances)), color=UNCERTAINTY)
    axes.set(yscale="log", xlim=(0, len(variances) + 1))
    axes.set(xlabel="eigenvector, best constrained first", ylabel="posterior std along it")
    axes.grid()
    return Drawing(
        "eigenbeams",
        "Eigenbeams",
        _caption(parts, variances),
        "Maps of the best-constrained eigenvectors of the covariance, and below them the spectrum of its eigenvalues.",
        figure,
    )


def _draw_beams(figure: SubFigure, channel: Channel, parts: int) -> None:
    """Draw a column for each eigenvector, real above imaginary part."""
    beams, variances = channel.arrays["eigen_beams"], channel.arrays["eigen_variances"]
    grid = figure.subplots(parts, len(beams), squeeze=False)
    image: AxesImage | None = None
    for number, (beam, variance) in enumerate(zip(beams, variances, strict=True)):
        turned = with_real_peak(beam)
        discs = [to_disc(part, channel.za, channel.az, 240) for part in (turned.real, turned.imag)[:parts]]
        # The scale is the height that few pixels exceed: some modes are singular at the zenith.
        scale = float(np.nanquantile(np.abs(discs), 0.995)) or 1.0
        for axes, disc in zip(grid[:, number], discs, strict=True):
            image = draw_disc(axes, disc / scale, "RdBu_r", Normalize(-1, 1), "0.4", "EN")
        mantissa, exponent = f"{np.sqrt(variance):.2e}".split("e")
        grid[0, number].set_title(rf"$\sigma_{{{number + 1}}} = {mantissa}\times10^{{{int(exponent)}}}$", fontsize=9)
    for axes, label in zip(grid[:, 0], ("real part", "imaginary part"), strict=False):
        axes.set_ylabel(label if parts == 2 else "")
    engine = figure.figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(h_pad=0.1)  # else titles touch the edge
    if image is not None:
        add_colorbar(figure, grid, image, "eigenbeam, scaled", "both")


def with_real_peak(beam: Array) -> Array:
    """Turn an eigenvector's free phase (or sign), (Nza, Naz), so that its largest value is real and positive."""
    peak = beam.ravel()[np.abs(beam).argmax()]
    return beam * (np.conj(peak) / np.abs(peak)) if peak else beam


def _caption(parts: int, variances: Array) -> str:
    condition = variances[-1] / variances[0]
    free = "phase makes the peak real" if parts == 2 else "sign makes the peak positive"
    return (
        "Top: the combinations of modes that the data determine best, that is, the eigenvectors of the posterior "
        "covariance with the smallest eigenvalues σ², seen on the sky. They resemble what the array measures directly: "
        "fringes of its most redundant baselines, mixed where their eigenvalues are nearly equal, and its point-spread "
        f"function. Their free {free}; they are projected as the maps of the beam. Bottom: posterior standard "
        f"deviation along all {len(variances):,} eigenvectors. The condition number of the covariance, the ratio of "
        f"its extreme eigenvalues, is {format_value(float(condition))}."
    )
