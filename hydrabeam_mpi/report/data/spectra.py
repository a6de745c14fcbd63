"""Power of data and residuals over fringe rate, and over delay where there are channels enough."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from scipy.signal.windows import blackmanharris

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray
from hydrabeam_mpi.report.data.sample import AFTER, BEFORE, Sample
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure

FEWEST = 8
"""Samples below which there is no spectrum to speak of."""
LOOKS = {"data": (REFERENCE, "-"), BEFORE: (MODEL, "-"), AFTER: (INFERRED, "-"), "noise": (REFERENCE, "--")}


def draw_spectra(samples: Sequence[Sample]) -> Drawing | None:
    """Draw the power of data, residuals and noise over fringe rate, and over delay; None with too few samples.

    ``samples`` are of all channels.
    """
    panels = {
        "fringe rate (mHz)": _over_fringe_rates(samples[len(samples) // 2]),
        "delay (ns)": _over_delays(samples),
    }
    drawn = {label: spectra for label, spectra in panels.items() if spectra is not None}
    if not drawn:
        return None
    figure = new_figure(3.3)
    panels_of = figure.subplots(1, len(drawn), squeeze=False)[0]
    for axes, (label, (place, lines)) in zip(panels_of, drawn.items(), strict=True):
        _draw(axes, label, place, lines)
    handles, labels = panels_of[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return Drawing(
        "spectra",
        f"Power over {' and '.join(label.partition(' (')[0] for label in drawn)}",
        "Mean power over the baselines of the sample of held-out visibilities, through a Blackman-Harris window: of "
        "the data, of what the model beam with nothing fitted leaves, of what all that was inferred leaves, and the "
        "level of the noise. Each baseline is turned to point East, so that the sky drifts alike for all.",
        f"Power against {' and '.join(drawn)}, before and after.",
        figure,
    )


def _draw(axes: Axes, label: str, place: FloatArray, lines: dict[str, FloatArray]) -> None:
    order = np.argsort(place)
    for name, power in lines.items():
        colour, style = LOOKS[name]
        axes.plot(place[order], power[order], style, color=colour, linewidth=1.1, label=name)
    axes.set(yscale="log", xlabel=label, ylabel="power (Jy²)")
    axes.grid()


Lines = tuple[FloatArray, dict[str, FloatArray]]


def _over_fringe_rates(sample: Sample) -> Lines | None:
    """Return fringe rates in mHz and what has which power there; of the longest run of evenly spaced times."""
    order = np.argsort(sample.jd)
    run = order[longest_even_run(sample.jd[order])]
    if len(run) < FEWEST:
        return None
    seconds = 86400 * float(np.median(np.diff(sample.jd[run])))
    place = np.fft.fftfreq(len(run), seconds) * 1e3
    flipped = sample.vectors[:, 0] < 0
    rows = {
        name: np.where(flipped, values.conj(), values)[run]
        for name, values in (("data", np.where(sample.used, sample.data, np.nan)), *sample.residuals.items())
    }
    return _spectra(place, rows, sample.noise[run])


def _over_delays(samples: Sequence[Sample]) -> Lines | None:
    """Return delays in ns and what has which power there, where channels are evenly spaced."""
    freqs = np.array([one.freq for one in samples])
    if len(freqs) < FEWEST or len(longest_even_run(freqs)) < len(freqs):
        return None
    place = np.fft.fftfreq(len(freqs), float(np.median(np.diff(freqs)))) * 1e9

    def stacked(of_channels: Sequence[Array]) -> Array:
        return np.array(of_channels).reshape(len(freqs), -1)

    rows = {"data": stacked([np.where(one.used, one.data, np.nan) for one in samples])}
    rows |= {name: stacked([one.residuals[name] for one in samples]) for name in (BEFORE, AFTER)}
    return _spectra(place, rows, stacked([one.noise for one in samples]))


def _spectra(place: Array, rows: dict[str, Array], noise: FloatArray) -> Lines | None:
    """Return the power of columns, (N, M), NaN where there are no samples; white noise has its variance."""
    known = np.isfinite(noise)
    enough: BoolArray = known.mean(axis=0) > 0.8
    if not enough.any():
        return None
    window = blackmanharris(len(place), sym=False)[:, np.newaxis] * known[:, enough]
    weight = np.sum(window**2, axis=0)

    def power(values: Array) -> FloatArray:
        transformed = np.fft.fft(window * np.nan_to_num(values[:, enough]), axis=0)
        return np.asarray(np.mean(np.abs(transformed) ** 2 / weight, axis=1))

    level = np.mean(np.sum(window**2 * np.nan_to_num(noise[:, enough]) ** 2, axis=0) / weight)
    return place, {name: power(values) for name, values in rows.items()} | {"noise": np.full(len(place), level)}


def longest_even_run(x: FloatArray) -> Array:
    """Return the indices of the longest run of ascending abscissae, (N,), whose steps are alike within a percent."""
    steps = np.diff(x)
    if not steps.size:
        return np.arange(len(x))
    alike = np.abs(steps / np.median(steps) - 1) < 0.01
    runs = np.split(np.arange(len(x)), np.flatnonzero(~alike) + 1)
    return max(runs, key=len)
