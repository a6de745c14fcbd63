"""The element's power beam: a main lobe on a pedestal of sidelobes, smooth, positive, and flat at the horizon.

    (1 + p) B = exp(-(l^2/sx^2 + m^2/sy^2)/2) exp(k . (l, m))
                + p exp(-(l^2 + m^2)/(2 w^2)) exp(c . (l, m, l^2 - m^2, 2 l m))

with l = sin za cos az to the East, m to the North, and sx, sy proportional to the wavelength. It has no null, so that
the root of the product of two antennas' beams is the product of their fields.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pyuvdata import UVBeam
from pyuvdata.analytic_beam import AnalyticBeam

FloatArray = NDArray[np.float64]
REFERENCE_FREQ = 150e6
FEEDS: dict[str, Any] = {
    "feed_array": np.array(["x", "y"]),
    "feed_angle": np.array([np.pi / 2, 0.0]),
    "mount_type": "fixed",
}


@dataclass(frozen=True)
class Shape:
    """The numbers that make a beam.

    Attributes
    ----------
    width : (float, float)
        sx, sy at 150 MHz, direction cosines.
    skew : (float, float)
        k, per direction cosine.
    pedestal, breadth : float
        p and w.
    modulation : tuple of float
        c.
    ripple : tuple of float
        Amplitude, radial frequency (cycles per direction cosine), azimuthal order and phase of a fine structure.
    extra : callable, optional
        (l, m) -> a relative change of the field, for single antennas.
    pointing : (float, float)
        Direction cosines (l, m) to which the beam's centre is moved.
    """

    width: tuple[float, float] = (0.22, 0.22)
    skew: tuple[float, float] = (0.0, 0.0)
    pedestal: float = 0.02
    breadth: float = 0.5
    modulation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    ripple: tuple[float, float, float, float] = (0.0, 6.0, 0.0, 0.0)
    extra: Callable[[FloatArray, FloatArray], FloatArray] | None = field(default=None, compare=False)
    pointing: tuple[float, float] = (0.0, 0.0)

    def power(self, za: FloatArray, az: FloatArray, freq: float) -> FloatArray:
        """Return B, (Npoints,)."""
        l, m = self._pointed(za, az)
        scale = REFERENCE_FREQ / freq
        sx, sy = self.width[0] * scale, self.width[1] * scale
        main = np.exp(-0.5 * ((l / sx) ** 2 + (m / sy) ** 2)) * np.exp(self.skew[0] * l + self.skew[1] * m)
        r2 = l**2 + m**2
        one, two, three, four = self.modulation
        shape = np.exp(one * l + two * m + three * (l**2 - m**2) + four * 2 * l * m)
        values = main + self.pedestal * np.exp(-0.5 * r2 / self.breadth**2) * shape
        height, cycles, order, phase = self.ripple
        if height:
            azimuth = np.arctan2(m, l)
            fine = np.cos(2 * np.pi * cycles * np.sqrt(r2) + phase) * np.cos(order * azimuth)
            values = values * np.exp(height * fine * r2 / (r2 + 0.1**2))
        if self.extra is not None:
            values = values * (1 + self.extra(l, m)) ** 2
        return np.asarray(values / (1 + self.pedestal))

    def _pointed(self, za: FloatArray, az: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return direction cosines about the beam's own axis, after a rotation that takes it to the zenith."""
        l, m, n = np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)
        tilt = float(np.hypot(*self.pointing))
        if not tilt:
            return l, m
        # Rodrigues' formula about the horizontal axis perpendicular to the tilt.
        east, north = self.pointing[0] / tilt, self.pointing[1] / tilt
        cos, sin = np.sqrt(1 - tilt**2), tilt
        along = l * east + m * north
        across = -l * north + m * east
        along = along * cos - n * sin
        return along * east - across * north, along * north + across * east


def field_of(shape: Shape, za: FloatArray, az: FloatArray, freq: float) -> FloatArray:
    """Return the field (component, feed, Npoints) of ideal feeds, East and North: Ludwig's third, without leakage."""
    root = np.sqrt(shape.power(za, az, freq))
    cos, sin = np.cos(az), np.sin(az)
    return root * np.array([[-sin, cos], [cos, sin]])


@dataclass(kw_only=True, eq=False)
class ShapedBeam(AnalyticBeam):
    """The beam as pyuvdata has it."""

    shape: Shape
    basis_vector_type: ClassVar[str] = "az_za"

    def _efield_eval(self, *, az_grid: FloatArray, za_grid: FloatArray, f_grid: FloatArray) -> NDArray[Any]:
        values = self._get_empty_data_array(az_grid.shape)
        for channel in range(len(f_grid)):
            field = field_of(self.shape, za_grid[channel], az_grid[channel], float(f_grid[channel, 0]))
            values[:, :, channel] = field[:, : values.shape[1]]
        return values


def pyuvdata_beam(shape: Shape) -> ShapedBeam:
    """Return the beam for matvis."""
    return ShapedBeam(shape=shape, **FEEDS)


def drawn_shape(rng: np.random.Generator, model: Shape, amount: float = 1.0) -> Shape:
    """Draw the sky's beam: widths off by 2%, sidelobes by 20%, and lopsided a little."""
    one, two = (s * (1 + 0.02 * amount * rng.standard_normal()) for s in model.width)
    return replace(
        model,
        width=(one, two),
        skew=tuple(0.05 * amount * rng.standard_normal(2)),
        pedestal=model.pedestal * np.exp(0.2 * amount * rng.standard_normal()),
        modulation=tuple(0.3 * amount * rng.standard_normal(4)),
    )


def write_beamfits(path: Path, shape: Shape, freqs: FloatArray) -> None:
    """Write the field of both feeds on a one-degree grid."""
    az, za = np.deg2rad(np.arange(360.0)), np.deg2rad(np.arange(91.0))
    za_grid, az_grid = np.meshgrid(za, az, indexing="ij")
    values = np.array([field_of(shape, za_grid, az_grid, float(freq)) for freq in freqs])
    directions = np.zeros((2, 2, *za_grid.shape))
    directions[0, 0] = directions[1, 1] = 1.0
    beam = UVBeam.new(
        telescope_name="undeclared",
        data_normalization="physical",
        freq_array=freqs,
        feed_name="ideal",
        model_name="smooth",
        **FEEDS,
        axis1_array=az,
        axis2_array=za,
        basis_vector_array=directions,
        data_array=values.transpose(1, 2, 0, 3, 4).astype(complex),
        history="",
    )
    beam.write_beamfits(str(path), clobber=True)
