"""The parameters of the effects that the loop added, with their error bars."""

from __future__ import annotations

import math
import re
import textwrap
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.loop.record import Entry, entries, number, title_of
from hydrabeam_mpi.report.page.style import AZ_0, AZ_90, INFERRED, MODEL, REFERENCE, UNCERTAINTY, Drawing, new_figure
from hydrabeam_mpi.report.page.ticks import PlainNumbers

NUMBER = re.compile(r"(?<![\w.])[-−+]?\d+(?:\.\d+)?")
AT = " at JD "
"""Between what a parameter is and the time to which it belongs."""
PLACES = ": azimuth"
"""How names of parameters end that are places, of which zero is none in particular."""
MOST_DECIMALS = 7
"""Of a number beside its bar; smaller ones are written with a power of ten."""
LISTED, NUMBERED, LINES, PANELS = 20, 400, 6, 8
TITLE = 40  # characters that a panel is wide
BESIDE = 18  # characters of a name for which there is room beside each of two panels
COLOURS = (INFERRED, MODEL, AZ_0, AZ_90, UNCERTAINTY, REFERENCE)


@dataclass(frozen=True, eq=False)
class _Family:
    """Parameters that differ only by the numbers in their names.

    Attributes
    ----------
    title, unit : str
    labels : list of str
        What tells them apart.
    freqs : ndarray, (Nfreqs,)
        Hz; NaN alone where they are shared by all channels.
    values, errors : ndarray, (Nparams, Nfreqs)
    """

    title: str
    unit: str
    labels: list[str]
    freqs: Array
    values: Array
    errors: Array

    def most_significant(self, n: int) -> Array:
        """Return the indices of the ``n`` parameters of highest significance, ascending, (n,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            size = np.nansum((self.values / self.errors) ** 2, axis=1)
        return np.sort(np.argsort(-np.nan_to_num(size, posinf=1e300), kind="stable")[:n])


def draw_parameters(entry: Entry, count: int) -> Drawing | None:
    """Draw the parameters of the effect that round ``count`` added; None where none are known."""
    families = _families(entries(entry, "parameters"))
    if not families:
        return None
    shown = families[:PANELS]
    listed = [label for family in shown if len(family.freqs) == 1 for label in family.labels]
    columns = 1 if max(map(len, listed), default=0) > BESIDE else min(len(shown), 2)
    rows = [shown[start : start + columns] for start in range(0, len(shown), columns)]
    heights = [max(_height(family) for family in row) for row in rows]
    figure = new_figure(sum(heights))
    grid = figure.subplots(len(rows), columns, squeeze=False, height_ratios=heights)
    for axes, family in zip(grid.ravel(), shown, strict=False):
        if len(family.freqs) > 1:
            _draw_lines(axes, family)
        elif _numbered(family):
            _draw_numbered(axes, family)
        else:
            _draw_list(axes, family)
    for axes in grid.ravel()[len(shown) :]:
        axes.set_visible(False)
    n = sum(len(family.labels) for family in families)
    title = title_of(entry)
    return Drawing(
        f"loop_parameters_{count}",
        f"Round {count}: {title}",
        _caption(n, any(len(family.freqs) > 1 and len(family.labels) > LINES for family in shown)),
        f"{len(shown)} panels with the parameters of {title}.",
        figure,
    )


def _caption(n: int, in_grey: bool) -> str:
    if n == 1:
        return "The parameter of the effect with its standard deviation, as fitted together with the beam."
    text = f"The {n:,} parameters of the effect with their standard deviations, as fitted together with the beam."
    return text + (f" In colour the {LINES} farthest from zero, in grey the others." if in_grey else "")


def _families(parameters: list[Entry]) -> list[_Family]:
    """Sort parameters by their names without numbers; single ones of a unit join."""
    by_name: dict[tuple[str, str], dict[str, dict[float, tuple[float, float]]]] = {}
    for parameter in parameters:
        name, unit = str(parameter.get("name", "")), str(parameter.get("unit") or "")
        cells = by_name.setdefault((_family_of(name), unit), {}).setdefault(name, {})
        cells[number(parameter, "freq_hz")] = (number(parameter, "value"), number(parameter, "std"))
    families: dict[tuple[str, str], dict[str, dict[float, tuple[float, float]]]] = {}
    for (title, unit), members in by_name.items():
        families.setdefault((title if len(members) > 1 else "", unit), {}).update(members)
    return [_family(title, unit, members) for (title, unit), members in families.items()]


def _family(title: str, unit: str, members: dict[str, dict[float, tuple[float, float]]]) -> _Family:
    # NaN stands for "all channels" and is a key like any other once it is replaced.
    keyed = [{-1.0 if math.isnan(freq) else freq: cell for freq, cell in cells.items()} for cells in members.values()]
    freqs = sorted({freq for cells in keyed for freq in cells})
    table = np.array([[cells.get(freq, (math.nan, math.nan)) for freq in freqs] for cells in keyed])
    labels = [name.partition(AT)[2] or _numbers_of(name) if title else name for name in members]
    return _Family(title, unit, labels, np.array(freqs), table[..., 0], table[..., 1])


def _numbers_of(name: str) -> str:
    """Return a name from its first number to its last: 3 of an antenna, 3–7 of a baseline, 13, -16 of a mode."""
    first, *others = NUMBER.finditer(name)
    last = others[-1] if others else first
    return re.sub(r"(?<=\d)-(?=\d)", "–", name[first.start() : last.end()])


def _family_of(name: str) -> str:
    """Return what parameters of a family have in common: all but the time, or all but the numbers."""
    what, at, _ = name.partition(AT)
    return f"{what}{AT}".rstrip() if at else _without_numbers(name)


def _without_numbers(name: str) -> str:
    """Return a name without its numbers: "harmonic l, m" of "harmonic l=3 m=-2"."""
    if not NUMBER.search(name):
        return name
    words = re.sub(r"[\s,–-]+", " ", NUMBER.sub("", name)).replace("( )", "")
    return re.sub(r"=\s*", "", re.sub(r"=\s+(?=\w)", ", ", words)).strip()


def _numbered(family: _Family) -> bool:
    return len(family.labels) > 6 and all(NUMBER.fullmatch(label) for label in family.labels)


def _height(family: _Family) -> float:
    if len(family.freqs) > 1 or _numbered(family):
        return 2.1
    return 0.17 * min(len(family.labels), LISTED) + 0.75


def _label(family: _Family, what: str = "") -> str:
    return f"{what or 'value'} ({family.unit})" if family.unit else what or "value"


def _heading(axes: Axes, family: _Family, shown: int) -> None:
    of_all = f"the {shown} of {len(family.labels):,} farthest from 0" if shown < len(family.labels) else ""
    lines = [*textwrap.wrap(family.title, TITLE), *([of_all] if of_all else [])]
    axes.set_title("\n".join(lines), fontsize=8.5)
    axes.grid()


def _draw_numbered(axes: Axes, family: _Family) -> None:
    """Draw values over the numbers of antennas or the like."""
    chosen = family.most_significant(NUMBERED)
    places = np.array([float(family.labels[place].replace("−", "-")) for place in chosen])
    xlabel = family.title.split(" ")[0]
    if family.title.endswith(AT.rstrip()):
        day = math.floor(places.min())
        places, xlabel = places - day, f"JD − {day}"
    axes.axhline(0, color="0.4", linewidth=0.7)
    size = 3.5 if len(chosen) <= 100 else 2
    values, errors = family.values[chosen, 0], np.nan_to_num(family.errors[chosen, 0])
    axes.errorbar(places, values, errors, fmt="o", markersize=size, color=INFERRED, elinewidth=0.8)
    axes.set(xlabel=xlabel, ylabel=_label(family))
    if all(place.is_integer() for place in places):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _heading(axes, family, len(chosen))


def _draw_list(axes: Axes, family: _Family) -> None:
    """Draw values one below the other with their names."""
    chosen = family.most_significant(LISTED)
    values, errors = family.values[chosen, 0], np.nan_to_num(family.errors[chosen, 0])
    places = np.arange(len(chosen))
    if all(label.endswith(PLACES) for label in family.labels):
        whole = PlainNumbers()
        whole.set_useOffset(False)
        axes.xaxis.set_major_formatter(whole)
    else:
        axes.axvline(0, color="0.4", linewidth=0.7)
    axes.errorbar(values, places, xerr=errors, fmt="o", markersize=3.5, color=INFERRED, elinewidth=0.8)
    axes.set_yticks(places, [family.labels[place] for place in chosen])
    axes.set(ylim=(len(chosen) - 0.4, -0.6), xlabel=_label(family))
    written = axes.secondary_yaxis("right")
    texts = list(map(_with_error, values.tolist(), errors.tolist()))
    written.set_yticks(places, texts, fontsize=7)
    written.tick_params(length=0)
    written.spines["right"].set_visible(False)
    axes.margins(x=0.12)
    _heading(axes, family, len(chosen))


def _with_error(value: float, error: float) -> str:
    """Write a value to the second digit of its error; one of four digits where it has none."""
    if not error > 0:
        return f"{value:.4g}".replace("-", "−")
    decimals = 1 - math.floor(math.log10(error))
    if -3 < decimals <= MOST_DECIMALS:
        text = f"{value:.{max(decimals, 0)}f} ± {error:.{max(decimals, 0)}f}"
    else:
        digits = max(math.floor(math.log10(abs(value) or error)) + decimals, 1)
        text = f"{value:.{digits}e} ± {error:.1e}"
    return text.replace("-", "−")


def _draw_lines(axes: Axes, family: _Family) -> None:
    """Draw the few most significant parameters over frequency, the others faintly."""
    chosen = family.most_significant(LINES)
    others = np.setdiff1d(family.most_significant(NUMBERED), chosen)
    freqs = family.freqs / 1e6
    axes.axhline(0, color="0.4", linewidth=0.7)
    axes.plot(freqs, family.values[others].T, color="0.8", linewidth=0.5)
    for place, colour in zip(chosen, COLOURS, strict=False):
        errors = np.nan_to_num(family.errors[place])
        label = family.labels[place]
        axes.errorbar(
            freqs, family.values[place], errors, fmt="o-", markersize=2.5, linewidth=0.8, elinewidth=0.8,
            color=colour, label=label,
        )  # fmt: skip
    if len(family.labels) > 1:
        # At the right: a power of ten that all values have in common stands at the left.
        above: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 0.98), "borderpad": 0, "borderaxespad": 0}
        axes.legend(fontsize=7, ncols=LINES, handlelength=1, columnspacing=0.8, handletextpad=0.3, **above)
    axes.set(xlabel="frequency (MHz)", ylabel=_label(family))
    # A single line has no legend to name it.
    title = family.title or (family.labels[0] if len(family.labels) == 1 else "")
    axes.set_title(title, fontsize=8.5, pad=14)
    axes.grid()
