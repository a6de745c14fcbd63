"""An array and a sky that are turned against each other: a wrong latitude, epoch, or survey of the ground."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from hydrabeam_mpi.data.observation import EARTH_RATE, ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.displaced import (
    ARCMIN,
    TurningSky,
    fringe_rates,
    rotate,
    rotation_rate,
    turn_per_second,
)

Fixed = Literal["ground", "stars", "array"]
AXES = {
    "ground": "sky turned about {}",
    "stars": "stars turned about {}",
    "array": "sky turned, but not on the beam, about {}",
}
"""What is told to be turned. A beam that is free to tilt, as the data want it, hardly tells the last from the first."""


class Orientation(TurningSky):
    """One rotation of the sky against the array at all times, by a vector East, North and Up.

    What it comes from the fit tells. The axis may be fixed on the "ground", as where the latitude is wrong or all
    elements are tilted with the plane of the array. It may be fixed to the "stars", as where coordinates are of another
    epoch than stated; then parameters are those at one sidereal time. Or only positions of antennas are turned, the
    other way round ("array"), as where North was missed in their survey, and the beam is where it should be.

    Parameters
    ----------
    fixed : {"ground", "stars", "array"}
        What the axis is fixed to, and what is turned about it.
    lst : float, optional
        Hours, at which an axis among the stars is where the parameters say; the middle of the data by default.
    """

    kind = "orientation"
    title = "orientation of array and sky"
    of_both_feeds = True

    def __init__(self, fixed: Fixed = "ground", lst: float | None = None) -> None:
        self.fixed = fixed
        self.lst = lst

    @property
    def displaces_sky(self) -> bool:  # type: ignore[override]
        """Whether the beam sees the sources elsewhere, too."""
        return self.fixed != "array"

    def describe(self) -> dict[str, Any]:
        """Return what the axis is fixed to, and from when it counts."""
        return {"fixed": self.fixed} | ({} if self.lst is None else {"lst": self.lst})

    def in_full(self, setup: ObservingSetup) -> Orientation:
        """Return the effect with the sidereal time of the middle of the data."""
        return Orientation(self.fixed, self._lst(setup) * 12 / np.pi)

    def variants(self, setup: ObservingSetup) -> list[Effect]:
        """Return what else the axis may be fixed to."""
        return [Orientation(fixed, self.lst).in_full(setup) for fixed in get_args(Fixed) if fixed != self.fixed]

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the same as is in the model."""
        return newest if isinstance(newest, Orientation) and newest.describe() != self.describe() else self

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the vector, by which the sky is turned counterclockwise as seen from its tip."""
        return Parameters.of([f"turn about {axis}" for axis in ("East", "North", "Up")], "arcmin", 1.0)

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return what is turned, (Nfreqs, 3): among the stars about the axes of the equator, else about those here."""
        turn, axes = np.eye(3), ("East", "North", "Up")
        if self.fixed == "stars":
            turn = _equatorial(self._lst(setup), setup.observation.latitude)
            axes = ("RA 0 h, Dec 0", "RA 6 h, Dec 0", "the North pole")
        names = tuple(AXES[self.fixed].format(axis) for axis in axes)
        return Told(names, ("arcmin",) * 3, x @ turn.T, np.sqrt(std**2 @ (turn**2).T), np.ones(3, dtype=bool))

    def rotations(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the rotation of the sky at each time, (Ntimes, 3)."""
        return np.asarray(ARCMIN * self._frames(block) @ x)

    def slopes(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what small further turns do, (Ntimes, Ngroups, 3); ``x`` is (n_params,)."""
        turns = np.array([rotation_rate(rotation) for rotation in self.rotations(block, x)]) @ self._frames(block)
        rates = self._rates_of_array(block, ARCMIN * x) if self.fixed == "array" else self.rates(block)
        return Columns(ARCMIN * rates @ turns, 3, by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the visibilities with what is turned minus those without, (Ntimes, Nbls)."""
        if self.fixed != "array" or not x.any():
            return super().added(block, x)
        turned = rotate(block.vectors.T, -ARCMIN * x).T
        after = block.integrate(lambda sources: sources.exact_beam[np.newaxis], vectors=turned)
        return block.spread(after[..., 0] - block.integral(self)[..., 0])

    def _rates_of_array(self, block: RowBlock, rotation: FloatArray) -> ComplexArray:
        """Return how visibilities change as sources, but not the beam, are turned, Jy per radian; as `rates`."""
        moments = block.integral(self)
        if rotation.any():
            moments = block.integrate(self.sky_columns, vectors=rotate(block.vectors.T, -rotation).T)
        return fringe_rates(block, moments[..., 1:4] @ rotate(np.eye(3), rotation).T)

    def _frames(self, block: RowBlock) -> FloatArray:
        """Return the matrices that take the axis from the parameters' time to each of the block's, (Ntimes, 3, 3)."""
        lsts = block.setup.observation.lsts[block.times]
        if self.fixed != "stars":
            return np.broadcast_to(np.eye(3), (len(lsts), 3, 3))
        per_radian = turn_per_second(block) / EARTH_RATE
        return np.array([rotate(np.eye(3), (lst - self._lst(block.setup)) * per_radian) for lst in lsts])

    def _lst(self, setup: ObservingSetup) -> float:
        """Return the sidereal time from which axes among the stars count, rad."""
        observation = setup.observation
        return float(observation.lsts[observation.Ntimes // 2]) if self.lst is None else self.lst * np.pi / 12


def _equatorial(lst: float, latitude: float) -> FloatArray:
    """Return the matrix that takes vectors East, North and Up to those of the equator, (3, 3)."""
    (sine, cosine), (low, high) = (np.sin(lst), np.cos(lst)), (np.cos(latitude), np.sin(latitude))
    east, north = [-sine, cosine, 0.0], [-high * cosine, -high * sine, low]
    return np.array([east, north, [low * cosine, low * sine, high]]).T
