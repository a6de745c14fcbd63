"""How a beam differs from its model as a whole: in amplitude, in size, in where it points, in its sidelobes.

A dish is a few per cent larger or smaller than it was modelled, and not quite round; its feed is off the axis, and
legs, rim and ground change sidelobes more than anything else. Each of that moves most coefficients of a beam together.
With l the direction cosines to East and North these changes are, to first order,

    amplitude   B'(l) = (1 + a) B(l)
    size        B'(l) = B(l - E l),    E symmetric: along East, along North, along their diagonal
    pointing    B'(l) = B(l - d)
    sidelobes   B'(l) = B(l) [1 + s h(l) cos(m az - az_0)],    h = 1 / (1 + |B| / B_s),    m = 0, 1, 2

with h one in sidelobes and next to nothing in the main lobe. A prior of independent coefficients takes any of them for
as many coincidences as there are coefficients. The widths that the evidence gives it are then far too narrow where the
data do not tell coefficients one by one, and what is left of the beam passes for effects that change in time.
"""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.rings import Pixels
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.model.fit import beam_pixels, fit_basis

AMPLITUDE = 0.1
"""Flux scales of catalogues and absolute calibration agree within a tenth, and data do not tell them from the beam."""
SIZE = 0.03
"""Effective diameters of dishes are known within some per cent: HERA's beams are perturbed by 1 and 2% in HDBI II."""
POINTING = np.deg2rad(0.5)
"""A feed that hangs 5 cm off the axis of a dish with a focal length of 5 m points half a degree away."""
SIDELOBES = 0.2
"""By so much sidelobes are modulated in HDBI II, and measured ones of dishes differ from electromagnetic models."""
SIDELOBE_LEVEL = 0.03
"""Power over the peak where a sidelobe begins: that of the first one of a dish is 15 to 20 dB down."""
WAVES = 2
"""Sidelobes may differ with azimuth up to this order: by the axis of the feed, and by the plane of polarisation."""


def shape_of(beam: Beam, basis: LinearBasis) -> Array:
    """Return what each of these changes does to the coefficients, by one standard deviation, (n_modes, k)."""
    pixels = beam_pixels(beam)
    changes = _moved(beam, pixels) + _scaled(pixels)
    return np.stack([fit_basis(basis, Pixels(pixels.za, pixels.az, one)).coeffs for one in changes], axis=-1)


def _moved(beam: Beam, pixels: Pixels) -> list[Array]:
    """Return the changes of size and pointing at the beam's samples, (Npixels,) each."""
    east, north = np.sin(pixels.za) * np.cos(pixels.az), np.sin(pixels.za) * np.sin(pixels.az)
    none, one = np.zeros_like(east), np.ones_like(east)
    of_size = [(SIZE * east, none), (none, SIZE * north), (SIZE * north, SIZE * east)]
    of_pointing = [(POINTING * one, none), (none, POINTING * one)]
    return [
        0.5 * (_at(beam, east - by_east, north - by_north) - _at(beam, east + by_east, north + by_north))
        for by_east, by_north in of_size + of_pointing
    ]


def _scaled(pixels: Pixels) -> list[Array]:
    """Return the changes of amplitude and sidelobes at the beam's samples, (Npixels,) each."""
    amplitude = np.abs(pixels.values)
    of_sidelobes = SIDELOBES * pixels.values / (1 + amplitude / (SIDELOBE_LEVEL * amplitude.max()))
    waves = [wave(m * pixels.az) for m in range(1, WAVES + 1) for wave in (np.cos, np.sin)]
    return [AMPLITUDE * pixels.values, of_sidelobes, *(of_sidelobes * wave for wave in waves)]


def _at(beam: Beam, east: FloatArray, north: FloatArray) -> Array:
    """Return the beam at direction cosines; beyond the horizon as it is at the horizon, (Npoints,)."""
    return beam(np.arcsin(np.minimum(np.hypot(east, north), 1.0)), np.arctan2(north, east))
