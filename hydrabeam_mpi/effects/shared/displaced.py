"""Skies and beams that are turned: exact rotations, and what they do to the visibilities.

A rotation is given by its vector r, ENU: about the axis r by |r| radians, counterclockwise as seen from its tip.
In a sky that is turned some sources rise and others set; the rates at which visibilities change leave out these jumps.
A beam that is turned sees the same sources as before; those below its own horizon it sees as if they were at that.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hydrabeam_mpi.data.observation import C_M_PER_S, EARTH_RATE, Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.model.bases.polar_table import PolarTable
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.positions import SourcePositions
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.model.tabulated import table_of

ARCMIN = np.pi / 180 / 60
POINTS_AT_ONCE = 4096
"""Directions whose coordinates, beam and slopes, about 150 bytes of each, stay in the cache together. Four times as
many took 1.2 times as long where each antenna sees 5,000 sources; what is worked out is the same."""
TURNED_SKY = "turned sky"
"""The name of the integrals of `turning_columns`."""
TILTS: FloatArray = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
"""Rotation vectors that take the zenith towards East and towards North, (3, 2)."""


def rotate(vectors: FloatArray, rotation: FloatArray) -> FloatArray:
    """Turn vectors (3, N) by a rotation vector (3,)."""
    return np.asarray(Rotation.from_rotvec(rotation).as_matrix() @ vectors)


def rotation_rate(rotation: FloatArray) -> FloatArray:
    """Return the matrix J, (3, 3), with d(R(r) s) = (J dr) x R(r) s: the left Jacobian of the rotation group."""
    x, y, z = rotation
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(rotation))
    # (1 - cos t) / t^2 and (t - sin t) / t^3; where the latter loses digits, its factor has none to give.
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    third = (1 - np.sinc(angle / np.pi)) / angle**2 if angle > 0 else 0.0
    return np.asarray(np.eye(3) + second * cross + third * cross @ cross)


def angles(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth of vectors (3, N), radians."""
    east, north, up = vectors
    return np.arctan2(np.sqrt(east**2 + north**2), up), azimuth(east, north)


def azimuth(east: FloatArray, north: FloatArray) -> FloatArray:
    """Return azimuths from 0 to 2 pi, (N,); faster than a modulus."""
    az = np.arctan2(north, east)
    return np.where(az < 0, az + 2 * np.pi, az)


@dataclass(frozen=True)
class BeamToHorizon:
    """A beam that below the horizon keeps the value that it has there; beams need not be known beyond.

    Its values are those of the beam's table, where it has one.
    """

    beam: Beam

    @property
    def table(self) -> PolarTable | None:
        """The table of the beam."""
        return table_of(self.beam)

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the beam, (Npoints,)."""
        return (self.table or self.beam)(np.minimum(za, np.pi / 2), az)


def seen_at(sources: Sources, vectors: FloatArray) -> Sources:
    """Return the sources as seen in other directions, (3, Nsrc)."""
    za, az = angles(vectors)
    seen = replace(sources, za=za, az=az, beam_function=BeamToHorizon(sources.beam_function))
    # A cached property that is known already.
    vars(seen)["enu"] = vectors
    return seen


def seen_turned(sources: Sources, rotations: FloatArray) -> Iterator[Sources]:
    """Yield the sources as beams see them that are turned by rotation vectors, (N, 3): by some at once, in a row.

    They are as many that what is worked out of them stays in the cache.
    """
    n_sources = len(sources.za)
    at_once = max(1, POINTS_AT_ONCE // max(n_sources, 1))
    for start in range(0, len(rotations), at_once):
        turns = Rotation.from_rotvec(-rotations[start : start + at_once]).as_matrix()
        n = len(turns)
        alike = replace(sources, index=np.tile(sources.index, n), flux=np.tile(sources.flux, n), factors={})
        yield seen_at(alike, (turns @ sources.enu).transpose(1, 0, 2).reshape(3, -1))


@dataclass(frozen=True)
class TurnedPositions:
    """Places of sources, turned at every time.

    Attributes
    ----------
    positions : SourcePositions
        Where they are without.
    rotations : dict of int to ndarray, (3,)
        Rotation vector of each time.
    """

    positions: SourcePositions
    rotations: dict[int, FloatArray]

    def above_horizon(self, itime: int, below: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the sources that are above the horizon once they are turned; see `SourcePositions.above_horizon`.

        Each is (Nup,).
        """
        rotation = self.rotations[itime]
        if not rotation.any():
            return self.positions.above_horizon(itime, below)
        index, za, az = self.positions.above_horizon(itime, below + float(np.linalg.norm(rotation)))
        za, az = angles(rotate(enu(za, az), rotation))
        up = za <= np.pi / 2 + below
        return index[up], za[up], az[up]

    def follow(self, sky: Sky) -> TurnedPositions:
        """Follow another sky, turned alike."""
        return replace(self, positions=self.positions.follow(sky))


def turned_sky(block: RowBlock, rotation: FloatArray) -> RowBlock:
    """Return the block with the sky turned by a rotation vector, (3,), at all times; only for `RowBlock.integrate`."""
    positions = TurnedPositions(block.positions, dict.fromkeys(block.times.tolist(), rotation))
    return replace(block, positions=positions, places=None, keeps_waves=False, followed={})


class _BeamAlone:
    """The visibilities themselves, as blocks keep what is integrated for effects."""

    kind = integrated_as = "the beam alone"

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the beam, (1, Nsrc)."""
        return sources.exact_beam[np.newaxis]


def added_by_displacing(effect: Effect, block: RowBlock, x: FloatArray) -> ComplexArray:
    """Return the visibilities of the sky that an effect displaces minus those of the sky as it is, (Ntimes, Nbls)."""
    if not x.any():
        return np.zeros(block.shape, dtype=complex)
    after = block.displaced_by(effect, x)
    return block.spread((after.integral(_BeamAlone()) - block.integral(_BeamAlone()))[..., 0])


def turn_per_second(block: RowBlock) -> FloatArray:
    """Return the rotation vector of the sky in a second: about the celestial pole, opposite to the Earth, (3,)."""
    latitude = block.setup.observation.latitude
    return -EARTH_RATE * np.array([0.0, np.cos(latitude), np.sin(latitude)])


def turning_columns(sources: Sources) -> FloatArray:
    """Return the beam, the beam times the unit vector, and the torque of the beam's slope, (7, Nsrc)."""
    beam = sources.exact_beam[np.newaxis]
    return np.concatenate([beam, beam * sources.enu, sources.torque])


def turning_rates(block: RowBlock, moments: ComplexArray) -> ComplexArray:
    """Return how visibilities change as the sky turns about east, north and up, Jy per radian.

    Both the integrals of `turning_columns`, (Ntimes, Ngroups, 7), and what is returned, (Ntimes, Ngroups, 3), are of
    the block's groups.
    """
    return moments[..., 4:] + fringe_rates(block, moments[..., 1:4])


def fringe_rates(block: RowBlock, moments: ComplexArray) -> ComplexArray:
    """Return how visibilities change as sources, but not the beam on them, are turned, Jy per radian.

    Both the integrals of the beam times the unit vector and what is returned are (Ntimes, Ngroups, 3).
    """
    # The phase k b.s changes by k b.(w x s) = k w.(s x b).
    return np.asarray(2j * np.pi * block.freq / C_M_PER_S * np.cross(moments, block.vectors))


def stretch_rate(block: RowBlock, moments: ComplexArray) -> ComplexArray:
    """Return how visibilities change as all baselines get longer by the same factor, Jy per unit of it.

    The integrals of the beam times the unit vector are (Ntimes, Ngroups, 3), what is returned (Ntimes, Ngroups).
    """
    # The phase k b.s changes by itself.
    return np.asarray(2j * np.pi * block.freq / C_M_PER_S * np.sum(moments * block.vectors, axis=-1))


def need_real_beam(setup: ObservingSetup) -> str | None:
    """Say why an effect that needs a real power beam cannot be used; None where it can."""
    if setup.observation.is_copolar:
        return None
    return f"the power beam of '{setup.observation.pols[0]}' is complex; equal feeds, such as 'ee', would tell"


class TurningSky(Effect):
    """The sky as a whole is turned against the array and its beam."""

    shared = True
    displaces_sky = True

    @abstractmethod
    def rotations(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the rotation vectors of the block's times, (Ntimes, 3)."""

    def displaced(self, block: RowBlock, x: FloatArray) -> SourcePositions:
        """Return the places of the turned sky."""
        return TurnedPositions(block.positions, dict(zip(block.times.tolist(), self.rotations(block, x), strict=True)))

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams."""
        return need_real_beam(setup)

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the `turning_columns`, (7, Nsrc)."""
        return turning_columns(sources)

    @property
    def integrated_as(self) -> str:
        """The name of what all that turns the sky needs."""
        return TURNED_SKY

    def rates(self, block: RowBlock) -> ComplexArray:
        """Return how visibilities change as the sky turns further about east, north and up, Jy per radian.

        The result is (Ntimes, Ngroups, 3).
        """
        return turning_rates(block, block.integral(self))

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the visibilities of the turned sky minus those of the sky as it is, (Ntimes, Nbls)."""
        return added_by_displacing(self, block, x)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what turning it further does."""
        return self.slopes(block.displaced_by(self, x), x)

    @abstractmethod
    def slopes(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the columns in a block whose sky is turned by ``x``, (n_params,)."""
