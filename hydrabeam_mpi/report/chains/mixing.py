"""R-hat and effective sample sizes of each block, as a table and as bars."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from hydrabeam_mpi.report.page.parts import part, set_table, together
from hydrabeam_mpi.report.page.scales import LOGARITHMIC, scale_values
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure
from hydrabeam_mpi.sampling.convergence import LARGEST_R_HAT, Diagnosis
from hydrabeam_mpi.sampling.status import Status, number
from hydrabeam_mpi.words import duration


def mixing_rows(diagnosis: Diagnosis) -> Markup:
    """Set the worst R-hat and the smallest effective sample sizes of each block."""
    rows = []
    for one in diagnosis.blocks:
        r_hat = f"{one.r_hat:.4g}" if one.r_hat > 0 else "–"
        sizes = (_written(size) for size in (one.ess_bulk, one.ess_tail, one.ess_per_second))
        worst = Markup("<code>{}</code>").format(one.worst)
        rows.append((one.block, str(one.n_parameters), r_hat, *sizes, worst))
    names = ("block", "parameters", "R-hat", "ESS bulk", "ESS tail", "ESS a second", "worst parameter")
    return set_table(names, rows, range(1, 6), "keys")


def progress_rows(status: Status) -> Markup:
    """Set how far each chain is."""
    rows = [(str(one.chain), str(one.n_draws), str(one.total), _written(one.seconds)) for one in status.chains]
    table = set_table(("chain", "draws", "of", "seconds a draw"), rows, range(4), "keys")
    left = f"At this pace the rest takes {duration(status.seconds_left)}."
    return together(table, part("paragraph", left) if status.seconds_left > 0 else Markup())


def draw_ess(diagnosis: Diagnosis) -> Drawing | None:
    """Draw the effective sample size that a block gains in a second."""
    known = [one for one in diagnosis.blocks if np.isfinite(one.ess_per_second) and one.ess_per_second > 0]
    if not known:
        return None
    figure = new_figure(2.6)
    axes, of_r_hat = figure.subplots(1, 2)
    places = np.arange(len(known))
    rates = [one.ess_per_second for one in known]
    axes.bar(places, rates, 0.6, color=MODEL)
    scale_values(axes, [0.0 if max(rates) < LOGARITHMIC * min(rates) else min(rates) / 2, *rates])
    axes.set(ylabel="ESS a second")
    if axes.get_yscale() == "linear":
        axes.set_ylim(0, None)
    excess = [max(one.r_hat - 1, 1e-5) for one in known]
    colours = [INFERRED if one.r_hat > LARGEST_R_HAT else MODEL for one in known]
    of_r_hat.bar(places, excess, 0.6, color=colours)
    of_r_hat.axhline(LARGEST_R_HAT - 1, color=REFERENCE, linestyle="--", linewidth=1)
    scale_values(of_r_hat, [min(*excess, LARGEST_R_HAT - 1) / 2, *excess, LARGEST_R_HAT - 1])
    of_r_hat.set(ylabel="R-hat − 1")
    for one in (axes, of_r_hat):
        one.set_xticks(places, [_short(block.block) for block in known], rotation=25, ha="right")
        one.grid(axis="y")
    return Drawing(
        "chains_ess",
        "What each block gains in a second, and how far it is from convergence",
        "Left: independent draws a second that the worst parameter of a block is worth, the smaller of bulk and tail, "
        "by the time of all chains together. Right: the largest R-hat of a block, less one; above the dashed line, "
        f"{LARGEST_R_HAT} (orange), the chains do not agree yet.",
        f"Bars of effective samples a second and of R-hat for {len(known)} blocks.",
        figure,
    )


def _short(name: str) -> str:
    return name if len(name) <= 22 else f"{name[:20]}…"


def _written(value: float) -> str:
    return number(value).replace("-", "–") if not value < 0 else number(value)
