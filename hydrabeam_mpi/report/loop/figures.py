"""The course of the loop: how all effects were ranked in each round, and how the held-out error fell."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from hydrabeam_mpi.report.loop.record import (
    Entry,
    candidate_name,
    candidate_title,
    entries,
    number,
    runner_up,
    title_of,
    written,
)
from hydrabeam_mpi.report.page.scales import scale_values, tick_label
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure

LINEAR = 10.0  # ln Bayes factors are drawn on a linear scale below this, on a logarithmic one above
SHOWN = 24  # effects in a panel
ABREAST = 3  # panels side by side
TITLE = 24  # characters of a title in a line, so that it stays above its own panel


def draw_ranking(loop: Entry) -> Drawing | None:
    """Draw the ln Bayes factors of all effects, one panel a round; the last one is what was left, where it is known."""
    panels = [
        (f"Round {count}: {title_of(entry)}", entry, scores)
        for count, entry in enumerate(entries(loop, "rounds"), 1)
        if (scores := _scores(entry))
    ]
    if left := _scores(loop, "last_ranking"):
        panels.append(("After the last round" if panels else "All effects", {}, left))
    if not panels:
        return None
    best: dict[str, float] = {}
    for _, _, scores in panels[::-1]:  # the first round decides the order
        best |= scores
    weighed = (one for _, entry, _ in panels for one in (entry, *entries(entry, "ranking")))
    weighed_last = entries(loop, "last_ranking")
    titles = {candidate_name(one): candidate_title(one) for one in (*weighed, *weighed_last)}
    names = sorted(best, key=lambda name: best[name], reverse=True)[:SHOWN]
    added = [candidate_name(entry) for _, entry, _ in panels]
    names += [name for name in added if name in best and name not in names]
    columns = min(ABREAST, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(rows * (0.175 * len(names) + 0.75) + 0.2)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    drawn = [value for _, _, scores in panels for name, value in scores.items() if name in names]
    for axes, panel in zip(grid.ravel(), panels, strict=False):
        _draw_round(axes, names, *panel)
    _scale(grid[0, 0], min(drawn), max(drawn), columns)
    grid[0, 0].set(ylim=(len(names) - 0.4, -0.6), yticks=range(len(names)))
    grid[0, 0].set_yticklabels([titles[name] for name in names])
    for index, axes in enumerate(grid.ravel()):
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", labelsize=7)
        axes.tick_params(labelbottom=index + columns >= len(panels), left=False)
        axes.set_visible(index < len(panels))
        if index + columns >= len(panels):
            axes.set_xlabel("ln Bayes factor")
    return Drawing(
        "loop_ranking",
        "How well each effect explains what is left",
        "Natural logarithm of the Bayes factor of every effect against the model of that round, after the beam has had "
        "its say, on a scale that is linear below 10. The effect that was added is orange, the runner-up dark; what is "
        "not above zero explains nothing. A dash stands for what was not weighed in that round.",
        f"{len(panels)} panels of horizontal bars, one bar for each of {len(names)} effects.",
        figure,
    )


def _scores(entry: Entry, key: str = "ranking") -> dict[str, float]:
    """Return the ln Bayes factors of a ranking by the names of the candidates."""
    scores = {candidate_name(candidate): number(candidate, "log_bayes_factor") for candidate in entries(entry, key)}
    return {name: score for name, score in scores.items() if math.isfinite(score)}


def _draw_round(axes: Axes, names: list[str], title: str, entry: Entry, scores: dict[str, float]) -> None:
    colours = {runner_up(entry): REFERENCE, candidate_name(entry): INFERRED}
    for place, name in enumerate(names):
        score = scores.get(name)
        if score is None:
            axes.text(0, place, " –", va="center", fontsize=7, color="0.6")
            continue
        axes.barh(place, score, height=0.72, color=colours.get(name, MODEL if score > 0 else "0.75"))
        axes.text(max(score, 0), place, f" {_short(score)}", va="center", fontsize=7, color="0.25")
    axes.axvline(0, color="0.4", linewidth=0.7)
    axes.set_title("\n".join(textwrap.wrap(title, TITLE)), fontsize=8.5)


def _short(value: float) -> str:
    """Write a ln Bayes factor in a few characters."""
    text = f"{round(value, 1) + 0.0:.1f}" if abs(value) < 100 else f"{value:,.0f}"
    if abs(value) >= 1e6:
        text = f"{value:.1e}".replace("e+0", "e").replace("e+", "e")
    return text.replace("-", "−")


def _scale(axes: Axes, lowest: float, highest: float, columns: int) -> None:
    """Set a symmetric logarithmic scale with few ticks, and room for the numbers at the bars' ends."""
    axes.set_xscale("symlog", linthresh=LINEAR, linscale=1)
    top = max(math.ceil(math.log10(max(highest, LINEAR))), 1)
    room = 1 + 0.35 * columns * max(top, 2) / 4
    bottom = min(1.3 * lowest, -1.0)
    axes.set_xlim(bottom, 10 ** (math.log10(max(highest, LINEAR)) + room))
    step = max(1, top // 3) if columns < ABREAST else max(1 + (top > 2), -(-top // 3))
    ticks = [0.0] + [10.0**power for power in range(step, top + 1, step)]
    if bottom < -LINEAR:
        ticks = [-(10.0 ** math.floor(math.log10(-bottom))), *ticks]
    axes.set_xticks(ticks, [tick_label(tick) for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()


def draw_fall(loop: Entry) -> Drawing | None:
    """Draw the held-out reduced χ² over the rounds; None without a round."""
    stages = [*_stages(loop)]
    if len(stages) < 2:
        return None
    names, values = [name for name, _ in stages], np.array([value for _, value in stages])
    figure = new_figure(2.7)
    axes = figure.subplots()
    places = np.arange(len(values))
    axes.axhline(1, color=REFERENCE, linestyle="--", linewidth=1)
    # At the left, where the error begins well above the noise.
    axes.text(-0.45, 1, "noise alone", va="bottom", ha="left", fontsize=8, color=REFERENCE)
    axes.plot(places, values, "o-", color=INFERRED, markersize=5)
    for place, value in zip(places, values, strict=True):
        # Below the line that stands for the noise where the point is.
        side: dict[str, Any] = {"xytext": (0, 7)} if value >= 1 else {"xytext": (0, -7), "va": "top"}
        axes.annotate(
            written(value), (place, value), textcoords="offset points", ha="center", fontsize=8, zorder=5, **side
        )
    slanted = len(values) > 5
    axes.set_xticks(places, names, rotation=25 if slanted else 0, ha="right" if slanted else "center")
    axes.set(xlim=(-0.5, len(values) - 0.5), ylabel="held-out reduced χ²")
    scale_values(axes, [1.0, *values.tolist()], 0.12 if np.all(values >= 1) else 0.2)
    axes.grid(axis="y")
    return Drawing(
        "loop_heldout",
        "The error on data that no fit has seen",
        "Reduced χ² of the held-out visibilities under the posterior predictive, at first, after each effect that was "
        "added, and where the beam's prior was adapted since. Noise alone gives 1.",
        f"A line from {written(float(values[0]))} to {written(float(values[-1]))} in {len(values) - 1} steps.",
        figure,
    )


def _stages(loop: Entry) -> Iterator[tuple[str, float]]:
    """Yield a name and the held-out reduced χ² of the first model and of each round's."""
    rounds = entries(loop, "rounds")
    first = number(loop, "error_before")
    first = number(rounds[0], "heldout_before") if rounds and math.isnan(first) else first
    if math.isfinite(first):
        yield "at first", first
    for count, entry in enumerate(rounds, 1):
        after = number(entry, "heldout_after")
        if math.isfinite(after):
            yield _stage(f"{count}: + {title_of(entry)}"), after
        # What was adapted before the first round is part of the model that it begins with.
        for adapted in (one for one in entries(loop, "prior_widths") if one.get("n_rounds") == count):
            yield _stage("the beam's prior adapted"), number(adapted, "predictive_chi2_after")


def _stage(name: str) -> str:
    return "\n".join(textwrap.wrap(name, 18))
