"""The paths of the brightest sources over the beam."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from hydrabeam_mpi.report.page.key_numbers import format_value
from hydrabeam_mpi.report.page.projection import VIEW, add_colorbar, draw_disc, to_disc
from hydrabeam_mpi.report.page.result import Channel, Result
from hydrabeam_mpi.report.page.style import Drawing, decades, new_figure

NAMED = 3  # of the sources, so that names have room


def draw_tracks(result: Result, channel: Channel) -> Drawing | None:
    """Draw the tracks of the sources that the beam sees brightest over the map of the inferred beam."""
    told = result.observed
    if "map_mean" not in channel.arrays or not len(told.get("track_flux", ())):
        return None
    beam = channel.arrays["map_mean"].real
    figure = new_figure(5.2)
    axes = figure.subplots()
    floor = max(decades(beam, 1)[0], 1e-6)
    square = to_disc(np.where(beam > 0, beam, np.nan), channel.za, channel.az)
    norm = LogNorm(floor, max(float(beam.max()), 10 * floor))
    image = draw_disc(axes, square, "magma", norm)
    add_colorbar(figure, axes, image, "power beam")
    named: list[tuple[str, tuple[float, float]]] = []
    for place, (flux, za, az) in enumerate(zip(told["track_flux"], told["track_za"], told["track_az"], strict=True)):
        radius = np.where(za <= np.pi / 2, np.sqrt(np.clip(1 - np.cos(za), 0, 1)), np.nan)
        east, north = radius * np.cos(az), radius * np.sin(az)
        axes.plot(east, north, color="white", linewidth=2.2)
        axes.plot(east, north, color="#56b4e9", linewidth=1.2)
        last = np.flatnonzero(np.isfinite(radius))[-1]
        axes.plot(east[last], north[last], "o", color="#56b4e9", mec="white", markersize=5)
        if place < NAMED:
            named.append((f"{format_value(float(flux))} Jy", (east[last], north[last])))
    _name(axes, named)
    return Drawing(
        "tracks",
        "The brightest sources",
        f"Paths of the {len(told['track_flux'])} sources that are the brightest through the beam at any time, over the "
        f"inferred beam; dots where they are last, with lines to the flux densities of the first {NAMED}. {VIEW}",
        "Map of the beam with lines along which sources move.",
        figure,
    )


def _name(axes: Axes, named: list[tuple[str, tuple[float, float]]]) -> None:
    """Write texts beside the disc, with lines to what they are of: upon the beam they would hide it."""
    for side in (-1, 1):
        here = sorted((one for one in named if (one[1][0] > 0) == (side > 0)), key=lambda one: one[1][1])
        for number, (text, at) in enumerate(here):
            height = at[1] + 0.12 * (number - (len(here) - 1) / 2)
            axes.annotate(
                text,
                at,
                (1.25 * side, height),
                fontsize=7.5,
                va="center",
                ha="left" if side > 0 else "right",
                arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.7},
                annotation_clip=False,
            )
