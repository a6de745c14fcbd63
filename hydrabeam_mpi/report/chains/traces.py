"""Traces, ranks and autocorrelation of the parameters that mix worst."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from arviz_stats.base.array import array_stats
from matplotlib.axes import Axes
from scipy.stats import rankdata

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.report.page.style import AZ_0, AZ_90, INFERRED, MODEL, REFERENCE, UNCERTAINTY, Drawing, new_figure
from hydrabeam_mpi.sampling.convergence import Diagnosis, Mixing
from hydrabeam_mpi.sampling.storage.store import ChainStore

COLOURS = (MODEL, INFERRED, AZ_0, AZ_90, UNCERTAINTY, REFERENCE)
"""Of the chains, over again where there are more."""
MOST_ROWS = 9
MOST_POINTS = 1000
"""Of a trace: more than there are pixels."""
RANK_BINS = 20
LONGEST_LAG = 100


@dataclass(frozen=True, eq=False)
class Traced:
    """A number of every draw.

    Attributes
    ----------
    label : str
    values : ndarray, (n_chains, n_draws)
    """

    label: str
    values: FloatArray


def draw_traces(store: ChainStore, diagnosis: Diagnosis) -> Drawing | None:
    """Draw the parameters with the largest R-hat and the smallest effective sample size of each block."""
    rows = list(_chosen(store, diagnosis))[:MOST_ROWS]
    if diagnosis.n_draws < 2 or not rows:
        return None
    figure = new_figure(1.25 * len(rows) + 0.6)
    grid = figure.subplots(len(rows), 3, squeeze=False, width_ratios=[2.4, 1, 1])
    for (trace, ranks, lags), row in zip(grid, rows, strict=True):
        _draw_trace(trace, row)
        _draw_ranks(ranks, row.values)
        _draw_lags(lags, row.values)
    for axes, title in zip(grid[0, 1:], ("ranks", "autocorrelation"), strict=True):
        axes.set_title(title)
    for axes, what in zip(grid[-1], ("draw after the warm-up", "rank of the draw", "lag in draws"), strict=True):
        axes.set_xlabel(what)
    return Drawing(
        "chains_traces",
        "Traces, ranks and autocorrelation",
        "Of each block the parameter with the largest R-hat, and the one with the smallest effective sample size where "
        "that is another; a colour for each chain. Left, its draws. Middle, how the ranks of a chain's draws among "
        "those of all chains are spread: where chains agree each is level, at 1 (dashed). Right, the correlation of "
        "draws that are some draws apart; the sooner it falls to zero, the more independent draws there are.",
        f"{len(rows)} rows of three panels: traces, histograms of ranks and autocorrelation of each chain.",
        figure,
    )


def _chosen(store: ChainStore, diagnosis: Diagnosis) -> Iterator[Traced]:
    chains, draws = diagnosis.chains, slice(store.warm_up, store.warm_up + diagnosis.n_draws)
    names = store.info_names(chains[0]) if chains else []
    for name in [one for one in names if one.startswith("log_")][:1]:
        yield Traced(name.replace("_", " "), np.stack([store.info(name, chain, draws) for chain in chains]))
    for block in diagnosis.blocks:
        variables = [one for one in diagnosis.variables if one.variable.block == block.block]
        for mixing, index in _worst(variables):
            part, at = divmod(index, mixing.variable.size)
            read = [store.read(mixing.variable.name, chain, draws, slice(at, at + 1))[:, 0] for chain in chains]
            values = np.stack(read)
            yield Traced(mixing.label(index), values.imag if part else values.real)


def _worst(variables: list[Mixing]) -> list[tuple[Mixing, int]]:
    """Choose the numbers with the largest R-hat and the smallest effective sample size."""
    places = [(one, index) for one in variables for index in np.flatnonzero(np.isfinite(one.r_hat))]
    if not places:
        return []
    by_r_hat = max(places, key=lambda at: at[0].r_hat[at[1]])
    by_size = min(places, key=lambda at: min(at[0].ess_bulk[at[1]], at[0].ess_tail[at[1]]))
    return [by_r_hat] if by_r_hat == by_size else [by_r_hat, by_size]


def _draw_trace(axes: Axes, row: Traced) -> None:
    step = -(-row.values.shape[1] // MOST_POINTS)
    for values, colour in zip(row.values, _colours(row.values), strict=True):
        axes.plot(np.arange(len(values))[::step], values[::step], color=colour, linewidth=0.5, alpha=0.85)
    axes.set_title(row.label if len(row.label) < 60 else f"{row.label[:58]}…")
    axes.set_xlim(0, row.values.shape[1])
    axes.locator_params(axis="y", nbins=4)


def _draw_ranks(axes: Axes, values: FloatArray) -> None:
    ranks = rankdata(values).reshape(values.shape)
    edges = np.linspace(0.5, values.size + 0.5, min(RANK_BINS, max(2, values.shape[1] // 5)) + 1)
    for of_chain, colour in zip(ranks, _colours(values), strict=True):
        counts = np.histogram(of_chain, edges)[0] * (len(edges) - 1) / values.shape[1]
        axes.stairs(counts, edges, color=colour, linewidth=0.9)
    axes.axhline(1, color=REFERENCE, linestyle="--", linewidth=0.8)
    axes.set(xlim=(edges[0], edges[-1]), ylim=(0, None))
    axes.locator_params(nbins=4)


def _draw_lags(axes: Axes, values: FloatArray) -> None:
    end = min(LONGEST_LAG, values.shape[1] // 2) + 1
    for of_chain, colour in zip(values, _colours(values), strict=True):
        if np.ptp(of_chain) > 0:
            axes.plot(array_stats.autocorr(of_chain)[:end], color=colour, linewidth=0.9)
    axes.axhline(0, color=REFERENCE, linewidth=0.7)
    axes.set(xlim=(0, end - 1), ylim=(-0.4, 1.05))
    axes.locator_params(axis="x", nbins=4)


def _colours(values: FloatArray) -> list[str]:
    return [COLOURS[chain % len(COLOURS)] for chain in range(len(values))]
