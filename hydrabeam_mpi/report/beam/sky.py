"""The posterior on the sky: maps, slices and scores of the map (HDBI II, section 4.2, eqs 26-29)."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm, Normalize, SymLogNorm
from matplotlib.lines import Line2D

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.key_numbers import format_value
from hydrabeam_mpi.report.page.projection import VIEW, add_colorbar, draw_disc, to_disc
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import AZ_0, AZ_90, MODEL, REFERENCE, Drawing, decades, new_figure


def difference(channel: Channel) -> tuple[Array, str]:
    """Return truth - MAP and its name, or MAP - model where there is no truth, (Nza, Naz)."""
    mean = channel.arrays["map_mean"]
    if channel.truth is not None:
        return channel.truth - mean, "truth − MAP"
    return mean - channel.arrays["map_model"], "MAP − model"


def scores(channel: Channel) -> Array:
    """Return the size of the difference in posterior standard deviations, (Nza, Naz); NaN where all modes vanish."""
    std = channel.arrays["map_std"]
    vanishing = std <= 1e-9 * std.max()
    return np.where(vanishing, np.nan, np.abs(difference(channel)[0]) / np.where(vanishing, 1.0, std))


def draw_maps(channel: Channel) -> Drawing | None:
    """Draw MAP beam, posterior standard deviation, error (or update) and its score."""
    if "map_mean" not in channel.arrays:
        return None
    mean, std = channel.arrays["map_mean"].real, channel.arrays["map_std"]
    error, name = difference(channel)
    panels = _Panels(channel)
    floor = max(decades(mean, 1)[0], 1e-6)
    part = ", real part" if np.iscomplexobj(channel.arrays["map_mean"]) else ""
    norm: Normalize = LogNorm(floor, max(float(mean.max()), 10 * floor))
    panels.draw(f"MAP beam{part}", np.where(mean > 0, mean, np.nan), "magma", norm, "power beam")
    z = scores(channel)
    std = np.where(np.isnan(z), np.nan, std)
    low, high = np.nanpercentile(std, [0.5, 100])
    panels.draw("posterior standard deviation", std, "viridis", LogNorm(low, max(high, 1.01 * low)), "power beam")
    limit = float(np.abs(error.real).max()) or 1.0
    linear = 10 ** np.round(np.log10(max(float(np.nanmedian(std)), 1e-3 * limit)))
    norm = SymLogNorm(linear, vmin=-limit, vmax=limit)
    panels.draw(f"{name}{part}", error.real, "RdBu_r", norm, "power beam", ink="0.4")
    norm = Normalize(0, max(5.0, float(np.nanpercentile(z, 99))))
    panels.draw(f"|{name}| / posterior std", z, "cividis", norm, "|z|", "max")
    return Drawing(
        "maps",
        "The beam on the sky",
        _map_caption(channel, mean),
        f"Four maps of the hemisphere: the most probable beam, its standard deviation, {name}, and that difference "
        "in standard deviations.",
        panels.figure,
    )


class _Panels:
    """A figure of two by two discs, filled one after the other."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self.figure = new_figure(6.4)
        self._axes = iter(self.figure.subplots(2, 2).ravel())

    def draw(
        self,
        title: str,
        values: Array,
        cmap: str,
        norm: Normalize,
        label: str,
        extend: str = "neither",
        ink: str = "white",
    ) -> None:
        """Draw a map, (Nza, Naz), on the next disc."""
        axes = next(self._axes)
        square = to_disc(values, self.channel.za, self.channel.az)
        image = draw_disc(axes, square, cmap, norm, ink)
        axes.set_title(title)
        add_colorbar(self.figure, axes, image, label, extend)


def _map_caption(channel: Channel, mean: Array) -> str:
    text = "Most probable beam, its posterior standard deviation, "
    text += (
        "its error against the beam that the data were simulated with, and that error in standard deviations. "
        if channel.truth is not None
        else "the change from the model beam, and that change in standard deviations. "
    )
    negative = np.mean(mean < 0)
    if negative > 0:
        text += f"White: the real part is negative ({100 * negative:.2g}% of the one-degree grid). "
    text += "The colours of the difference are linear around zero, to the first ticks, and logarithmic beyond. "
    if channel.truth is not None:
        text += "Where |z| is far above 3 the error is not noise: the basis or the sky model cannot follow the data. "
    return text + VIEW


BAND = 3  # standard deviations on either side


def draw_slices(channel: Channel) -> Drawing | None:
    """Draw cuts of the beam at azimuth 0 and 90 degrees, and the size of the error along them."""
    if "map_mean" not in channel.arrays:
        return None
    amplitude = shows_amplitude(channel)
    part = np.abs if amplitude else np.real
    mean, std = part(channel.arrays["map_mean"]), channel.arrays["map_std"]
    reference, name = (channel.truth, "truth") if channel.truth is not None else (channel.arrays["map_model"], "model")
    error, what = difference(channel)
    figure = new_figure(5.0)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    za = np.rad2deg(channel.za)
    for degrees, colour in ((0, AZ_0), (90, AZ_90)):
        cut = int(np.abs(np.exp(1j * channel.az) - np.exp(1j * np.deg2rad(degrees))).argmin())
        top.plot(za, mean[:, cut], color=colour, label=f"MAP, az = {degrees}°")
        band = BAND * std[:, cut]
        top.fill_between(za, mean[:, cut] - band, mean[:, cut] + band, color=colour, alpha=0.25, linewidth=0)
        top.plot(za, part(reference[:, cut]), "--", color=colour, linewidth=1, label=f"{name}, az = {degrees}°")
        bottom.plot(za, np.abs(error[:, cut]), color=colour, label=f"|{what}|, az = {degrees}°")
        bottom.plot(za, std[:, cut], ":", color=colour, label=f"posterior std, az = {degrees}°")
    floor = max(decades(part(reference), 0.5)[0], 1e-6)
    top.set(yscale="log", ylabel="|power beam|" if amplitude else "power beam", ylim=(floor, 2))
    bottom.set(yscale="log", ylabel="difference", xlabel="zenith angle (deg)", xlim=(0, za[-1]))
    for axes in (top, bottom):
        axes.grid()
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    low, high = bottom.get_ylim()
    bottom.set_ylim(low, high * (high / low) ** 0.2)  # room for the legend
    kinds = [Line2D([], [], color=REFERENCE, linestyle=style) for style in ("-", ":")]
    bottom.legend(kinds, [f"|{what}|", "posterior standard deviation"], ncols=2, loc="upper right")
    shown = "amplitude" if amplitude else "real part"
    return Drawing(
        "slices",
        "Slices",
        f"Cuts through the beam ({shown}) at azimuth 0° (East) and 90° (North): inferred (solid), with a band of "
        f"±{BAND}σ of the posterior, which shows where the beam is faint, and {name} (dashed). Below, the size of "
        f"{what} along the cuts, with the posterior standard deviation (dotted).",
        f"Beam against zenith angle at two azimuths, inferred and {name}, on a logarithmic scale; below, their "
        "difference.",
        figure,
    )


def shows_amplitude(channel: Channel) -> bool:
    """Whether slices show amplitudes: where more than 1% of the map is negative, its real part has no logarithm."""
    return bool(np.mean(channel.arrays["map_mean"].real < 0) > 0.01)


def draw_map_scores(channel: Channel) -> Drawing | None:
    """Draw the histogram of |z| over the map with the distribution expected of it."""
    if "map_mean" not in channel.arrays:
        return None
    name = difference(channel)[1]
    z = scores(channel)
    z = z[np.isfinite(z)]
    figure = new_figure(3.3)
    axes = figure.subplots()
    far = bool(np.percentile(z, 95) > 10)
    end = float(z.max()) if far else max(6.0, float(np.percentile(z, 99.5)))
    edges = np.geomspace(0.05, end, 61) if far else np.linspace(0, end, 61)
    density = np.histogram(z, edges)[0] / z.size / np.diff(edges)
    axes.stairs(density, edges, fill=True, color=MODEL, alpha=0.3)
    axes.stairs(density, edges, color=MODEL, linewidth=1, label="one-degree grid")
    x = np.geomspace(0.05, edges[-1], 2001) if far else np.linspace(0, edges[-1], 2001)
    expected, law = expected_scores(x, channel.is_complex)
    axes.plot(x, expected, "--", color=REFERENCE, label=law)
    axes.set(xlim=(edges[0], edges[-1]), xlabel=f"|z| = |{name}| / posterior std", ylabel="density")
    if far:
        axes.set(xscale="log", yscale="log", ylim=(0.5 * density[density > 0].min(), 2))
    axes.legend()
    axes.grid()
    return Drawing(
        "map_scores",
        "Scores of the map",
        _score_caption(channel, z, float(edges[-1]), law),
        f"Histogram of |z| over the map against the {law}.",
        figure,
    )


def _score_caption(channel: Channel, z: Array, end: float, law: str) -> str:
    meaning = (
        "expected of an inference whose basis and sky are complete"
        if channel.truth is not None
        else "which would be seen if the model beam were the truth"
    )
    median = float(np.sqrt(np.log(2))) if channel.is_complex else 0.6745  # of the law
    text = (
        f"Distribution of |z| over the one-degree grid. Dashed: the {law}, {meaning}. The median is "
        f"{format_value(float(np.median(z)))}, expected {median:.2f}; the largest is {format_value(float(z.max()))}. "
    )
    beyond = np.mean(z > end)
    return (text + (f"Beyond the axis lie {100 * beyond:.2g}% of the grid." if beyond else "")).strip()


def expected_scores(z: Array, is_complex: bool) -> tuple[Array, str]:
    """Return the density of |z| of a perfect inference at ``z``, (N,), and its name.

    E|z|^2 = 1: Rayleigh with scale 1/sqrt 2 where the coefficients are complex, half-normal where they are real.
    """
    if is_complex:
        return 2 * z * np.exp(-(z**2)), "Rayleigh distribution"
    return np.sqrt(2 / np.pi) * np.exp(-(z**2) / 2), "half-normal distribution"
