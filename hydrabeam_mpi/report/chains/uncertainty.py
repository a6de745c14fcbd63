"""The beam's uncertainty with all else uncertain, too, against that with all else known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LogNorm, Normalize

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.report.chains.pooled import Pooled
from hydrabeam_mpi.report.page.projection import VIEW, add_colorbar, draw_disc, to_disc
from hydrabeam_mpi.report.page.style import AZ_0, AZ_90, Drawing, new_figure

ZA = np.deg2rad(np.arange(0.0, 91.0, 2.0))
AZ = np.deg2rad(np.arange(0.0, 360.0, 5.0))
SHARE = 0.25
"""Largest number of other parameters a draw with which their part in the beam can be told from chance."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviation of the beam on the sky, (Nza, Naz) each.

    Attributes
    ----------
    marginal, conditional : ndarray
        With all else drawn, and given all else.
    """

    marginal: FloatArray
    conditional: FloatArray

    @property
    def ratio(self) -> FloatArray:
        """The first over the second; NaN where all functions vanish."""
        seen = self.marginal > 1e-9 * self.marginal.max()
        return np.divide(self.marginal, self.conditional, out=np.full_like(self.marginal, np.nan), where=seen)


def on_sky(pooled: Pooled, coefficients: Array) -> Array:
    """Return beams with these coefficients, (n, n_modes), on the sky, (n, Nza, Naz)."""
    za, az = (grid.ravel() for grid in np.meshgrid(ZA, AZ, indexing="ij"))
    values = pooled.basis.column_coeffs(coefficients) @ pooled.basis.columns(za, az)
    return np.asarray(values).reshape(len(coefficients), len(ZA), len(AZ))


def marginal_std(pooled: Pooled) -> FloatArray:
    """Return the standard deviation of the beam on the sky with all else drawn, (Nza, Naz)."""
    return np.asarray(on_sky(pooled, pooled.beam).std(axis=0, ddof=1))


def spread_of(pooled: Pooled) -> Spread | None:
    """Return the two standard deviations; None where the second is not known.

    The second is that of what is left of the draws of the beam after a linear regression on all else. It is not known
    where there are too few draws for the number of other parameters.
    """
    left, strengths, _ = np.linalg.svd(pooled.standardised, full_matrices=False)
    directions = left[:, strengths > 1e-8 * max(strengths.max(initial=0.0), 1.0)]
    n, rank = directions.shape
    if not rank or rank > SHARE * n:
        return None
    beams = on_sky(pooled, pooled.beam).reshape(n, -1)
    away = beams - beams.mean(axis=0)
    remains = away - directions @ (directions.T @ away)
    conditional = np.sqrt(np.sum(np.abs(remains) ** 2, axis=0) / (n - 1 - rank))
    return Spread(marginal_std(pooled), conditional.reshape(len(ZA), len(AZ)))


def draw_spread(spread: Spread) -> Drawing:
    """Draw the marginal standard deviation and its ratio to the conditional one as maps, and both along cuts."""
    figure = new_figure(6.1)
    grid = figure.add_gridspec(2, 2, height_ratios=[3.1, 2.6])
    left, right, axes = (figure.add_subplot(place) for place in (grid[0, 0], grid[0, 1], grid[1, :]))
    ratio, seen = spread.ratio, np.isfinite(spread.ratio)
    std = np.where(seen, spread.marginal, np.nan)
    low, high = np.nanpercentile(std, [0.5, 100])
    panels = (
        (left, std, "viridis", LogNorm(low, max(high, 1.01 * low)), "marginal standard deviation", "power beam"),
        (right, ratio, "cividis", _norm(ratio[seen]), "marginal / conditional", "ratio"),
    )
    for disc, values, cmap, norm, title, label in panels:
        image = draw_disc(disc, to_disc(values, ZA, AZ), cmap, norm)
        disc.set_title(title)
        add_colorbar(figure, disc, image, label, "max" if disc is right else "neither")
    for degrees, colour in ((0, AZ_0), (90, AZ_90)):
        at = int(np.abs(AZ - np.deg2rad(degrees)).argmin())
        axes.plot(np.rad2deg(ZA), spread.marginal[:, at], color=colour, label=f"marginal, az = {degrees}°")
        axes.plot(np.rad2deg(ZA), spread.conditional[:, at], ":", color=colour, label=f"conditional, az = {degrees}°")
    axes.set(yscale="log", xlim=(0, 90), xlabel="zenith angle (deg)", ylabel="std of the power beam")
    axes.grid()
    axes.legend(ncols=2)
    middle = float(np.median(ratio[seen]))
    return Drawing(
        "chains_uncertainty",
        "How uncertain the beam is when all else is uncertain, too",
        "Standard deviation of the beam over the draws (marginal), and what is left of it once all other blocks are "
        "known (conditional: the draws less their linear regression on all other parameters). The marginal is wider "
        f"by a factor of {middle:.2f} in the median over the grid and of {float(ratio[seen].max()):.2f} at most: so "
        f"much a fit that takes the others as known understates the error. {VIEW}",
        "Two maps of the hemisphere, the standard deviation of the beam and its ratio to that with all else known; "
        "below, both against zenith angle.",
        figure,
    )


def _norm(ratio: FloatArray) -> Normalize:
    return Normalize(1, max(1.1, float(np.percentile(ratio, 99))))
