"""Where the sources stand: zenith angle and azimuth of those above the horizon, one time after another.

The horizon is a hard cut at za = 90 deg without refraction, as in pyuvsim, matvis and fftvis. Nothing of size
sources x times is kept but where that is small.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Protocol

import erfa
import numpy as np
from astropy.coordinates import AltAz
from astropy.coordinates.erfa_astrom import erfa_astrom
from astropy.time import Time

from hydrabeam_mpi.data.observation import FloatArray, IntArray, Observation
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.random import generator

MOST_KEPT = 2_000_000
"""Places that `ApparentPositions` keep: 32 MB."""


class SourcePositions(Protocol):
    """The apparent places of a sky's sources during an observation."""

    def above_horizon(self, itime: int, below: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the sources above the horizon at one time.

        Parameters
        ----------
        itime : int
            Index into the observation's times.
        below : float
            How far below the horizon they may be, radians.

        Returns
        -------
        index : ndarray of int, (Nabove,)
            Which of the sky's sources they are, ascending.
        za, az : ndarray, (Nabove,)
            Zenith angle, at most 90 deg and ``below``, and azimuth from East through North in [0, 2 pi], radians.
        """

    def follow(self, sky: Sky) -> SourcePositions:
        """Follow another sky through the same times by the same rule."""


class Followed:
    """A few sources that are followed, whose places are found once for each time.

    Parameters
    ----------
    positions : SourcePositions
    """

    def __init__(self, positions: SourcePositions) -> None:
        self._positions = positions
        self._known: dict[int, tuple[IntArray, FloatArray, FloatArray]] = {}

    def above_horizon(self, itime: int) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the sources above the horizon, each (Nup,), not to be changed; see `SourcePositions.above_horizon`."""
        if itime not in self._known:
            self._known[itime] = self._positions.above_horizon(itime)
        return self._known[itime]


@dataclass(frozen=True)
class PositionsByTime:
    """Places of sources that follow another rule at every time.

    Attributes
    ----------
    at : dict of int to SourcePositions
        By index into the observation's times.
    """

    at: dict[int, SourcePositions]

    def above_horizon(self, itime: int, below: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the sources above the horizon, each (Nup,); see `SourcePositions.above_horizon`."""
        return self.at[itime].above_horizon(itime, below)

    def follow(self, sky: Sky) -> PositionsByTime:
        """Follow another sky by the same rules."""
        return PositionsByTime({itime: one.follow(sky) for itime, one in self.at.items()})


class ApparentPositions:
    """Catalogue places (ICRS) as seen from the observatory: precession, nutation, aberration, polar motion.

    One ERFA context per time serves all sources of all skies that are followed. The atmosphere does not refract. Places
    at a time that is asked for again, as fits do that turn the sky, are kept as long as there are not too many.
    """

    def __init__(self, sky: Sky, observation: Observation) -> None:
        self._ra, self._dec = sky.ra, sky.dec
        self._asked: set[int] = set()
        self._kept: dict[int, tuple[FloatArray, FloatArray]] = {}
        times = Time(observation.times, format="jd", scale="utc")
        self._contexts = erfa_astrom.get().apco(AltAz(obstime=times, location=observation.location))

    def above_horizon(self, itime: int, below: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the sources above the horizon, each (Nup,); see `SourcePositions.above_horizon`."""
        az_from_north, za = self._kept.get(itime) or self._find(itime)
        index = np.flatnonzero(za <= np.pi / 2 + below)
        return index, za[index], (np.pi / 2 - az_from_north[index]) % (2 * np.pi)

    def follow(self, sky: Sky) -> ApparentPositions:
        """Follow another sky; see `SourcePositions.follow`."""
        other = copy(self)
        other._ra, other._dec = sky.ra, sky.dec
        other._asked, other._kept = set(), {}
        return other

    def _find(self, itime: int) -> tuple[FloatArray, FloatArray]:
        """Return azimuths from North and zenith angles of all sources at a time, (Nsrc,) each."""
        context = self._contexts[itime]
        az_from_north, za, *_ = erfa.atioq(*erfa.atciqz(self._ra, self._dec, context), context)
        if itime in self._asked and (len(self._kept) + 1) * len(za) <= MOST_KEPT:
            self._kept[itime] = az_from_north, za
        self._asked.add(itime)
        return az_from_north, za


class RotatedPositions:
    """Places of date turned by the local sidereal time alone, hour angle = LST - RA: for mocks."""

    def __init__(self, sky: Sky, observation: Observation) -> None:
        self._observation = observation
        self._ra = sky.ra
        self._sin_dec, self._cos_dec = np.sin(sky.dec), np.cos(sky.dec)
        self._lat = observation.latitude
        self._lsts = observation.lsts

    def above_horizon(self, itime: int, below: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the sources above the horizon, each (Nup,); see `SourcePositions.above_horizon`."""
        hour_angle = self._lsts[itime] - self._ra
        to_meridian = self._cos_dec * np.cos(hour_angle)
        up = np.sin(self._lat) * self._sin_dec + np.cos(self._lat) * to_meridian
        index = np.flatnonzero(up >= -np.sin(below))
        east = -self._cos_dec[index] * np.sin(hour_angle[index])
        north = np.cos(self._lat) * self._sin_dec[index] - np.sin(self._lat) * to_meridian[index]
        # arctan2 keeps full precision at the zenith, where an arccos of `up` would lose half of the digits.
        za = np.arctan2(np.hypot(east, north), up[index])
        return index, za, np.arctan2(north, east) % (2 * np.pi)

    def follow(self, sky: Sky) -> RotatedPositions:
        """Follow another sky; see `SourcePositions.follow`."""
        return RotatedPositions(sky, self._observation)


class ManyDirections:
    """A sky of very many directions, turned as a whole: for maps, in which each is looked at by itself.

    That takes a hundredth of the time of finding each by itself. What is no turn is the aberration, of which the first
    order is counted, and that the Sun deflects light, by less than 0.1 arc seconds but for the few degrees beside it.

    Parameters
    ----------
    positions : SourcePositions
        Whose rule they follow: one that turns the sky.
    sky : Sky
    """

    def __init__(self, positions: SourcePositions, sky: Sky) -> None:
        self._icrs = np.stack([np.cos(sky.dec) * np.cos(sky.ra), np.cos(sky.dec) * np.sin(sky.ra), np.sin(sky.dec)])
        quarter = np.pi / 2
        axes = Sky(np.array([0, 2, 1, 3, 0, 0]) * quarter, np.array([0, 0, 0, 0, 1, -1]) * quarter, np.ones((1, 6)))
        self._axes = positions.follow(axes)

    def above_horizon(self, itime: int) -> tuple[IntArray, FloatArray]:
        """Find those above the horizon, (Nup,), and return unit vectors towards them, ENU, (3, Nup)."""
        _, za, az = self._axes.above_horizon(itime, below=np.pi / 2)
        ends = np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])
        # s + v - (s.v) s is odd in s but for the aberration by v, and its mean over six ends of axes is 2 v / 3.
        turned = 0.5 * (ends[:, ::2] - ends[:, 1::2]) @ self._icrs
        aberration = 1.5 * ends.mean(axis=1)[:, np.newaxis]
        seen = turned + aberration - (aberration * turned).sum(axis=0) * turned
        index = np.flatnonzero(seen[2] >= 0)
        return index, seen[:, index]


def count_above_horizon(sky: Sky, observation: Observation, max_sample: int = 2000) -> FloatArray:
    """Estimate cheaply how many sources are up at each time, to balance the load of ranks.

    Plain rotation of at most ``max_sample`` sources drawn the same way on every rank, scaled up; exact for a
    smaller sky turned by sidereal time.

    Returns
    -------
    ndarray, (Ntimes,)
    """
    sample = np.arange(sky.Nsrc)
    if sky.Nsrc > max_sample:
        sample = generator(0, "count_above_horizon").integers(sky.Nsrc, size=max_sample)
    lat = observation.latitude
    cos_hour_angle = np.cos(observation.lsts[:, np.newaxis] - sky.ra[sample])
    up = np.sin(lat) * np.sin(sky.dec[sample]) + np.cos(lat) * np.cos(sky.dec[sample]) * cos_hour_angle
    return (up >= 0).sum(axis=1) * (sky.Nsrc / max(len(sample), 1))
