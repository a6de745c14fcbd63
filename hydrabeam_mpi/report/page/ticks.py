"""Numbers at axes in plain characters: matplotlib's own, in its mathematical notation, take a quarter of a report."""

from __future__ import annotations

import re

from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, ScalarFormatter

SUPERSCRIPTS = str.maketrans("0123456789-\N{MINUS SIGN}", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻")


def plain_ticks(figure: Figure) -> None:
    """Let all linear and logarithmic axes of a figure have plain numbers; others stay as they are."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            major, minor = axis.get_major_formatter(), axis.get_minor_formatter()
            if type(major) is ScalarFormatter:
                axis.set_major_formatter(PlainNumbers())
            if type(major) is LogFormatterSciNotation:
                axis.set_major_formatter(PlainPowers())
            if type(minor) is LogFormatterSciNotation:
                axis.set_minor_formatter(PlainPowers(minor_thresholds=minor.minor_thresholds))


class PlainPowers(LogFormatterSciNotation):
    """Powers such as 10⁻³."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the label of a number; see matplotlib."""
        return _plain(super().__call__(x, pos))


class PlainNumbers(ScalarFormatter):
    """Numbers as they are, with a power of ten beside the axis where they are large or small."""

    def __init__(self) -> None:
        super().__init__(useMathText=False)

    def get_offset(self) -> str:
        """Return what stands beside the axis."""
        return re.sub(r"(^1|(?<=\d))e([+\N{MINUS SIGN}-]?\d+)", _power, super().get_offset())


def _power(found: re.Match[str]) -> str:
    return "×10" + found.group(2).lstrip("+").translate(SUPERSCRIPTS)


def _plain(label: str) -> str:
    """Turn a power of ten in mathematical notation into characters."""
    found = re.fullmatch(r"\$\\mathdefault\{(.*)\}\$", label)
    if found is None:
        return label
    text = re.sub(r"\^\{(.*?)\}", lambda power: power.group(1).translate(SUPERSCRIPTS), found.group(1))
    return text.replace(r"\times", "×").replace("-", "\N{MINUS SIGN}")
