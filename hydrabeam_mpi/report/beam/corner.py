"""How the leading parameters hang together: marginals and pairs of the Gaussian posterior."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, Drawing, new_figure

N_MODES, N_EFFECTS = 4, 3
"""Coefficients, and parameters of effects: more panels could not be read on a page."""


def draw_corner(channel: Channel, covariance: Array) -> Drawing | None:
    """Draw the coefficients that the data moved the most, in units of their std, and the leading effects' parameters.

    ``covariance`` is the coefficients', (n, n).
    """
    names, joint = leading(channel, covariance)
    if len(names) < 2:
        return None
    std = np.sqrt(np.diag(joint))
    correlation = joint / np.outer(std, std)
    n = len(names)
    figure = new_figure(6.6)
    grid = figure.subplots(n, n, sharex=True, squeeze=False)
    x = np.linspace(-3.5, 3.5, 141)
    for row in range(n):
        for column in range(n):
            axes: Axes = grid[row, column]
            if column > row:
                axes.set_visible(False)
                continue
            if column == row:
                axes.fill_between(x, np.exp(-0.5 * x**2), color=INFERRED, alpha=0.3, linewidth=0)
                axes.plot(x, np.exp(-0.5 * x**2), color=INFERRED, linewidth=1)
                axes.set(ylim=(0, 1.15), yticks=[])
                axes.set_title(names[row], fontsize=6.5, loc="center")
            else:
                _draw_pair(axes, float(correlation[row, column]))
            axes.set(xlim=(-3.5, 3.5), xticks=(-2, 0, 2))
            axes.tick_params(labelsize=6.5)
            if column:
                axes.tick_params(labelleft=False)
    for place, name in enumerate(names):
        grid[-1, place].set_xlabel(name, fontsize=6.5)
    return Drawing(
        "corner",
        "Leading parameters",
        "Marginal posteriors, and pairs of them with their 1σ and 2σ ellipses and correlations: of the coefficients "
        "that the data moved the most from the prior mean, and of the most significant parameters of effects, where "
        "there are any. All are about the posterior mean in units of the posterior standard deviation. The "
        "posterior is a Gaussian, so this is all of it.",
        f"Triangle of panels with ellipses of {n} parameters.",
        figure,
    )


def leading(channel: Channel, covariance: Array) -> tuple[list[str], FloatArray]:
    """Return names and joint covariance, (N, N) real, of the leading coefficients and parameters of effects.

    Of complex coefficients the real parts; their covariance is half of the real part of E[(b - mean)(b - mean)^H].
    """
    mean, prior_mean, std = (channel.arrays[key] for key in ("mean", "prior_mean", "std"))
    modes = np.sort(np.argsort(-np.abs(mean - prior_mean) / std, kind="stable")[:N_MODES])
    names = [f"mode {mode + 1}" for mode in modes.tolist()]
    joint = covariance[np.ix_(modes, modes)].real * (0.5 if channel.is_complex else 1.0)
    known, significance = _parameters(channel)
    spread = channel.arrays.get("effects_covariance", np.zeros((0, 0)))
    if not known or len(known) != len(spread):
        return names, joint
    response = channel.arrays["effects_beam_response"]
    chosen = np.sort(np.argsort(-significance, kind="stable")[:N_EFFECTS])
    moved = np.concatenate([response, np.zeros((len(mean) - len(response), len(spread)))])[modes]
    across = (moved @ spread[:, chosen]).real
    return [*names, *(known[place] for place in chosen)], np.block(
        [[joint, across], [across.T, spread[np.ix_(chosen, chosen)]]]
    )


def _parameters(channel: Channel) -> tuple[list[str], FloatArray]:
    """Return names of the parameters of effects, and how many standard deviations each is from zero."""
    names: list[str] = []
    values: list[float] = []
    for entry in channel.effects:
        names += ["\n".join(textwrap.wrap(name, 16)) for name in entry["names"]]
        rows = [entry[key][min(channel.number, len(entry[key]) - 1)] for key in ("values", "std")]
        values += np.abs(np.divide(*rows)).tolist()
    return names, np.array(values)


def _draw_pair(axes: Axes, correlation: float) -> None:
    """Draw the ellipses of two parameters of unit variance."""
    widths = np.sqrt(2 * np.clip([1 + correlation, 1 - correlation], 0, None))
    for sigma, alpha in ((2, 0.25), (1, 0.45)):
        width, height = (sigma * np.sqrt(2) * widths).tolist()
        axes.add_patch(Ellipse((0, 0), width, height, angle=45, color=MODEL, alpha=alpha, linewidth=0))
    axes.text(0.04, 0.95, f"{correlation:+.2f}".replace("-", "−"), transform=axes.transAxes, va="top", fontsize=7)
    axes.set(ylim=(-3.5, 3.5), yticks=(-2, 0, 2))
