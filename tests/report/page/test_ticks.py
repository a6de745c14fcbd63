"""Numbers at axes are those that matplotlib gives, in plain characters."""

from __future__ import annotations

from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from hydrabeam_mpi.report.page.ticks import plain_ticks


def labels(axis: Axis) -> list[str]:
    return [tick.get_text() for tick in axis.get_ticklabels() if tick.get_text()]


def drawn(low: float, high: float, scale: str = "linear") -> tuple[list[str], str]:
    """Return the labels of an axis, and what stands beside it."""
    figure = Figure()
    axes = figure.subplots()
    axes.set_yscale(scale)
    axes.set_ylim(low, high)
    plain_ticks(figure)
    FigureCanvasAgg(figure).draw()
    return labels(axes.yaxis), axes.yaxis.get_major_formatter().get_offset()


def test_powers_of_ten() -> None:
    found, beside = drawn(1e-3, 1e2, "log")
    # matplotlib has a tick beyond either end.
    assert (found[1:-1], beside) == (["10⁻³", "10⁻²", "10⁻¹", "10⁰", "10¹", "10²"], "")
    found, _ = drawn(-1e2, 1e2, "symlog")
    assert found[0] == "\N{MINUS SIGN}10²"
    assert "0" in found
    assert not any("$" in one or "-" in one for one in found)


def test_numbers() -> None:
    assert drawn(0.0, 2e-7)[1] == "×10⁻⁷"
    assert drawn(2460000.1, 2460000.2)[1] == "+2.46×10⁶"
    assert drawn(1e9 + 1, 1e9 + 2)[1] == "+1×10⁹"
    assert drawn(0.0, 1.0) == (["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"], "")


def test_what_has_no_numbers_gets_none() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.yaxis.set_major_formatter(NullFormatter())
    plain_ticks(figure)
    FigureCanvasAgg(figure).draw()
    assert labels(axes.yaxis) == []
