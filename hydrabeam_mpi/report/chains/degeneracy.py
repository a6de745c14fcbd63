"""Directions in which the beam and all else trade off against each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.report.chains.pooled import Pooled, standardised
from hydrabeam_mpi.report.chains.uncertainty import AZ, ZA, on_sky
from hydrabeam_mpi.report.page.projection import add_colorbar, draw_disc, to_disc
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, Drawing, new_figure

SHOWN = 3
"""Directions that are drawn."""
BARS = 8
"""Parameters that are named of each."""
LONGEST = 34
"""Characters of a parameter's name beside its bar."""
SHIFTS = 19
"""Times that draws of the beam are compared with other draws of all else: chance gives more in one case of twenty."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of all else and what the beam does along it.

    Attributes
    ----------
    strength : float
        Singular value of the correlations between the beam's coefficients and all else.
    response : ndarray, (Nza, Naz)
        Change of the beam with one standard deviation along the direction.
    correlations : ndarray, (n_others,)
        Of each parameter with the direction.
    """

    strength: float
    response: FloatArray
    correlations: FloatArray


def directions_of(pooled: Pooled) -> tuple[list[Direction], float]:
    """Find the directions whose correlation with the beam is beyond chance.

    The singular value decomposition of the correlations K = B^T E / (n - 1) of standardised draws B of the beam's
    coefficients and E of all else. Chance is what the same gives with E shifted against B along the draws, which
    leaves the correlation of draws in time as it is.

    Returns
    -------
    directions : list of Direction
        The strongest first, `SHOWN` at most.
    chance : float
        The largest singular value over `SHIFTS` shifts.
    """
    beam, others = standardised(_real(pooled.beam)), pooled.standardised
    n = len(beam)
    if others.shape[1] == 0 or n < 2 * SHIFTS:
        return [], np.inf
    # K is B^T E, and both have at most n directions: what is decomposed is no larger.
    _, of_beam = np.linalg.qr(beam.T) if beam.shape[1] > n else (None, beam.T)
    q, of_others = np.linalg.qr(others.T)
    chance = 0.0
    for shift in np.linspace(0, n, SHIFTS + 2)[1:-1].astype(int):
        moved = np.roll(of_others, shift, axis=1)
        chance = max(chance, float(np.linalg.norm(of_beam @ moved.T, 2)) / (n - 1))
    _, strengths, right = np.linalg.svd(of_beam @ of_others.T / (n - 1), full_matrices=False)
    found = [
        _direction(pooled, float(strength), q @ vector)
        for strength, vector in zip(strengths[:SHOWN], right[:SHOWN], strict=True)
        if strength > chance
    ]
    return found, chance


def _direction(pooled: Pooled, strength: float, weights: FloatArray) -> Direction:
    along = standardised((pooled.standardised @ weights)[:, np.newaxis])[:, 0]
    n = len(along)
    correlations = along @ pooled.standardised / (n - 1)
    sign = np.sign(correlations[np.abs(correlations).argmax()])
    change = sign * (along @ (pooled.beam - pooled.beam.mean(axis=0))) / (n - 1)
    return Direction(strength, on_sky(pooled, change[np.newaxis])[0].real, sign * correlations)


def draw_directions(pooled: Pooled, directions: list[Direction], chance: float) -> Drawing | None:
    """Draw the beam's response to each direction, and the parameters that make it up."""
    if not directions:
        return None
    figure = new_figure(2.6 * len(directions))
    grid = figure.subplots(len(directions), 2, squeeze=False, width_ratios=[1, 1.25])
    for number, (one, (disc, bars)) in enumerate(zip(directions, grid, strict=True), 1):
        limit = float(np.abs(one.response).max()) or 1.0
        image = draw_disc(disc, to_disc(one.response, ZA, AZ), "RdBu_r", Normalize(-limit, limit), "0.4")
        disc.set_title(f"{number}: singular value {one.strength:.2g}")
        add_colorbar(figure, disc, image, "change of the beam")
        _draw_bars(bars, one, pooled.labels)
    return Drawing(
        "chains_degeneracy",
        "Where the beam and all else trade off",
        "Leading directions of the correlations between the beam's coefficients and all other parameters, by singular "
        f"value; chance alone gives up to {chance:.2g}. Left: the change of the beam with one standard deviation along "
        "the direction. Right: the parameters that the direction is made of, by their correlation with it.",
        f"{len(directions)} rows: a map of the hemisphere and a bar chart of correlations.",
        figure,
    )


def _draw_bars(axes: Axes, one: Direction, labels: list[str]) -> None:
    largest = np.argsort(-np.abs(one.correlations))[:BARS]
    values = one.correlations[largest]
    axes.barh(range(len(values)), values, 0.7, color=[INFERRED if value > 0 else MODEL for value in values])
    axes.set_yticks(range(len(values)), [_short(labels[index]) for index in largest], fontsize=7)
    axes.set(xlim=(-1.02, 1.02), ylim=(BARS - 0.4, -0.6), xlabel="correlation with the direction")
    axes.axvline(0, color="0.4", linewidth=0.7)
    axes.grid(axis="x")


def _short(label: str) -> str:
    """Fit a label into the space beside the bars; the name of the variable goes first."""
    if len(label) > LONGEST:
        label = label.partition("[")[2].removesuffix("]") or label
    return label if len(label) <= LONGEST else f"{label[: LONGEST - 1]}…"


def _real(beam: Array) -> FloatArray:
    """Return real and imaginary parts side by side."""
    return np.concatenate([beam.real, beam.imag], axis=1) if np.iscomplexobj(beam) else np.asarray(beam)
