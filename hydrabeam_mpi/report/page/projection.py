"""The hemisphere as a disc: Lambert's azimuthal equal-area projection, East to the right and North up.

The radius is sqrt(1 - cos za), so that equal areas are equal solid angles and the horizon is the unit circle.
With azimuth from East through North the picture is a map seen from above, as one draws the array: looking down.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, SymLogNorm
from matplotlib.figure import FigureBase
from matplotlib.image import AxesImage
from matplotlib.patches import Circle
from scipy.ndimage import map_coordinates

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.report.page.style import colour_map

VIEW = (
    "Equal-area projection of the hemisphere with radius √(1 − cos za): zenith in the middle, horizon at the rim, "
    "circles at za = 30° and 60°. Azimuth runs from East (right, az = 0°) through North (up, az = 90°): the view is "
    "from above, looking down on the array as on a map."
)
COMPASS = {"E": (1.09, 0), "N": (0, 1.09), "W": (-1.09, 0), "S": (0, -1.09)}


def to_disc(values: Array, za: Array, az: Array, pixels: int = 360) -> Array:
    """Resample a map from the grid of angles to the square around the disc, linearly.

    Parameters
    ----------
    values : ndarray, (Nza, Naz)
        Real; NaN marks what is not to be drawn.
    za, az : ndarray, (Nza,), (Naz,)
        Radians, ascending; azimuths evenly spaced around the circle.
    pixels : int
        Side of the square.

    Returns
    -------
    ndarray, (pixels, pixels)
        First axis northwards, second eastwards; NaN below the horizon and beyond the grid.
    """
    centres = (np.arange(pixels) + 0.5) * 2 / pixels - 1
    east, north = np.meshgrid(centres, centres)
    cos_za = 1 - east**2 - north**2
    inside = cos_za >= max(np.cos(za[-1]), 0.0)
    ring = np.interp(np.arccos(cos_za[inside]), za, np.arange(len(za)))
    step = (np.arctan2(north, east)[inside] - az[0]) % (2 * np.pi) / (2 * np.pi) * len(az)
    wrapped = np.concatenate([values, values[:, :1]], axis=1)
    square = np.full(inside.shape, np.nan)
    square[inside] = map_coordinates(wrapped, [ring, step], order=1, mode="nearest")
    return square


def draw_disc(
    axes: Axes, square: Array, cmap: str, norm: Normalize, ink: str = "white", directions: str = "ENWS"
) -> AxesImage:
    """Draw a map resampled to (Npixels, Npixels).

    ``ink`` colours the circles, ``directions`` says which letters stand at the rim.
    """
    image = axes.imshow(
        square, cmap=colour_map(cmap), norm=norm, extent=(-1, 1, -1, 1), origin="lower", interpolation="nearest"
    )
    for degrees, width, colour in ((30, 0.5, ink), (60, 0.5, ink), (90, 0.8, "black")):
        radius = float(np.sqrt(1 - np.cos(np.deg2rad(degrees))))
        axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=colour, linewidth=width))
    for letter in directions:
        axes.text(*COMPASS[letter], letter, ha="center", va="center", fontsize=8, color="0.25")
    axes.set(xlim=(-1.16, 1.16), ylim=(-1.16, 1.16), xticks=[], yticks=[], aspect="equal")
    axes.set_frame_on(False)
    return image


def add_colorbar(figure: FigureBase, axes: Axes | Array, image: AxesImage, label: str, extend: str = "neither") -> None:
    """Put a thin colour bar beside a disc, or beside several, (Nrows, Ncolumns), that share their colours."""
    bar = figure.colorbar(image, ax=axes, shrink=0.8, aspect=24, pad=0.02, extend=extend)
    if isinstance(image.norm, SymLogNorm):
        decades = 10.0 ** np.arange(np.log10(image.norm.linthresh), np.log10(image.norm.vmax or 1.0))
        bar.set_ticks([*-decades[::-1], 0.0, *decades])
    bar.set_label(label)
