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

Data with a signal of hundreds of times the noise also see what is of second order in them: a dish that is 5% smaller
has a beam that is off by a per cent more than to first order, which a source's flux would take up. So the products of
two of these numbers, which are N(0, 1), are numbers of their own: of two different ones the variance is 1, and of one
with itself the mean square is 3.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.model.bases.base import LinearBasis, has_part
from hydrabeam_mpi.model.bases.rings import Pixels
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.model.fit import beam_pixels, fit_several
from hydrabeam_mpi.model.rime import Beam as Evaluable
from hydrabeam_mpi.model.tabulated import from_table

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
    """Return what each of these changes does to the coefficients, by one standard deviation, (n_modes, k).

    Those of first order come first: five of size and pointing, amplitude, and sidelobes. After them come products,
    but for those that do nothing.
    """
    pixels = beam_pixels(beam)
    moved, amplitude = _Moved(beam, pixels), np.abs(pixels.values)
    in_sidelobes = 1 / (1 + amplitude / (SIDELOBE_LEVEL * amplitude.max()))
    waves = [SIDELOBES * np.ones_like(amplitude)]
    waves += [SIDELOBES * wave(m * pixels.az) for m in range(1, WAVES + 1) for wave in (np.cos, np.sin)]
    moves, sidelobes = moved.first(), [in_sidelobes * pixels.values * wave for wave in waves]
    # Of h B it is h^2 that the change of B is multiplied by.
    of_both = [in_sidelobes**2 * wave * move for wave in waves for move in moves]
    louder = [AMPLITUDE * one for one in moves + sidelobes]
    first = [*moves, AMPLITUDE * pixels.values, *sidelobes]
    changes = first + moved.second() + of_both + louder
    fitted = fit_several(basis, pixels, np.stack(changes)).T
    does_something = has_part(np.linalg.norm(fitted, axis=0))
    does_something[: len(first)] = True
    return fitted[:, does_something]


class _Moved:
    """A beam that is larger or points elsewhere, at its samples."""

    def __init__(self, beam: Beam, pixels: Pixels) -> None:
        self.beam, self.values = from_table(beam), pixels.values
        self.east, self.north = np.sin(pixels.za) * np.cos(pixels.az), np.sin(pixels.za) * np.sin(pixels.az)
        none, one = np.zeros_like(self.east), np.ones_like(self.east)
        of_size = [(SIZE * self.east, none), (none, SIZE * self.north), (SIZE * self.north, SIZE * self.east)]
        self.moves = np.array([*of_size, (POINTING * one, none), (none, POINTING * one)])
        self.there = {(place, sign): self._by(sign * move) for place, move in enumerate(self.moves) for sign in (1, -1)}

    def first(self) -> list[Array]:
        """Return what each move changes to first order."""
        return [0.5 * (self.there[place, 1] - self.there[place, -1]) for place in range(len(self.moves))]

    def second(self) -> list[Array]:
        """Return what each two of them, or one twice, change to second order."""
        twice = [
            0.5 * np.sqrt(3) * (self.there[place, 1] + self.there[place, -1] - 2 * self.values)
            for place in range(len(self.moves))
        ]
        both = [
            0.25 * (self._by(one + two) + self._by(-one - two) - self._by(one - two) - self._by(two - one))
            for one, two in combinations(self.moves, 2)
        ]
        return twice + both

    def _by(self, move: FloatArray) -> Array:
        return _at(self.beam, self.east - move[0], self.north - move[1])


def _at(beam: Evaluable, east: FloatArray, north: FloatArray) -> Array:
    """Return the beam at direction cosines; beyond the horizon as it is at the horizon, (Npoints,)."""
    return beam(np.arcsin(np.minimum(np.hypot(east, north), 1.0)), np.arctan2(north, east) % (2 * np.pi))
