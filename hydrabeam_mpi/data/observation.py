"""What was observed: antennas, baselines, frequencies, times, and the visibilities themselves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from astropy.constants import c as speed_of_light
from astropy.coordinates import EarthLocation
from astropy.utils import iers
from numpy.typing import NDArray

# Here, as all that follows the sky knows of observations: what merely imports the package waits for no astronomy.
# Compute nodes have no network: a missing IERS table must not stall a run, and the packaged one is good to
# well below an arcsecond, however old: its predictions hold for the dates that they are of. What dates past its end
# cost, `hydrabeam_mpi.model.earth_orientation` tells.
iers.conf.auto_download = False
iers.conf.auto_max_age = None
iers.conf.iers_degraded_accuracy = "warn"

# float64 or complex128
Array = NDArray[Any]
FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

C_M_PER_S: float = speed_of_light.value
SIDEREAL_DAY = 0.99726956632908
"""Days of UT1: a turn of the Earth against the stars."""
EARTH_RATE = 7.292115e-5
"""Rotation of the Earth, rad/s."""
EARTH_RADIUS = 6.371e6
"""Mean, m."""


def are_copolar(pols: Iterable[str]) -> bool:
    """Whether all polarisations are of equal feeds, so that their power beams are real."""
    return all(pol[0] == pol[1] for pol in pols)


@dataclass(frozen=True)
class Observation:
    """The metadata of the selected data, known to every rank; no visibilities.

    Attributes
    ----------
    telescope_name : str
    location : astropy.coordinates.EarthLocation
        Origin of the antenna positions.
    antenna_numbers : ndarray of int, (Nants,)
    antenna_names : tuple of str
    antpos : ndarray, (Nants, 3)
        East, north, up in metres.
    antpairs : ndarray of int, (Nbls, 2)
        Antenna numbers (ant1, ant2) of the cross-correlations.
    freqs, channel_width : ndarray, (Nfreqs,)
        Channel centres and widths in Hz.
    times : ndarray, (Ntimes,)
        Centres of the integrations, Julian dates (UTC).
    lsts : ndarray, (Ntimes,)
        Local apparent sidereal times in radians.
    integration_time : ndarray, (Ntimes,)
        Seconds.
    pols : tuple of str
        Polarisations as the data name them, such as "ee".
    pol_convention : {"sum", "avg"}, optional
        Of files that do not state it: V = 1/2 I B (also where this is None), or V = I B.
    stated_conventions : tuple of {"sum", "avg", None}
        What files state of it, None being nothing; distinct.
    uncalibrated : bool
        Whether any of the files says that its visibilities are not calibrated.
    is_smeared : bool
        Whether visibilities are means over their integrations and channels, rather than of one instant and frequency.
    is_phased : bool
        Whether any of the files has visibilities that follow a place on the sky, as they are no more once read.
    doubts : tuple of str
        What is odd about the files together.
    exclude_times : tuple of (float, float)
        Julian dates from and to: integrations whose centres lie within are taken as flagged.
    exclude_baselines : tuple of (int, int)
        Antenna numbers, in either order, of baselines that are taken as flagged.
    """

    telescope_name: str
    location: EarthLocation
    antenna_numbers: IntArray
    antenna_names: tuple[str, ...]
    antpos: FloatArray
    antpairs: IntArray
    freqs: FloatArray
    channel_width: FloatArray
    times: FloatArray
    lsts: FloatArray
    integration_time: FloatArray
    pols: tuple[str, ...]
    pol_convention: str | None = None
    stated_conventions: tuple[str | None, ...] = (None,)
    uncalibrated: bool = False
    is_smeared: bool = False
    is_phased: bool = False
    doubts: tuple[str, ...] = ()
    exclude_times: tuple[tuple[float, float], ...] = ()
    exclude_baselines: tuple[tuple[int, int], ...] = ()

    def excluded(self, times: IntArray, antpairs: IntArray) -> BoolArray:
        """Tell which samples of some times (indices) and baselines (antenna numbers) are excluded, (Ntimes, Nbls)."""
        jd = self.times[times]
        bad_times = np.zeros(len(times), dtype=bool)
        for first, last in self.exclude_times:
            bad_times |= (jd >= first) & (jd <= last)
        pairs = {frozenset(pair) for pair in self.exclude_baselines}
        bad_bls = np.array([frozenset(pair) in pairs for pair in antpairs.tolist()], dtype=bool)
        return bad_times[:, np.newaxis] | bad_bls

    @property
    def conventions(self) -> frozenset[str]:
        """The conventions of polarisation in which visibilities were, before reading made all of them V = 1/2 I B."""
        return frozenset(stated or self.pol_convention or "sum" for stated in self.stated_conventions)

    @property
    def convention(self) -> str | None:
        """The one of `conventions`, None where files differ."""
        return next(iter(self.conventions)) if len(self.conventions) == 1 else None

    @cached_property
    def latitude(self) -> float:
        """Radians, geodetic."""
        return float(self.location.lat.rad)

    @property
    def Nants(self) -> int:
        """Number of antennas with a position."""
        return len(self.antenna_numbers)

    @property
    def Nbls(self) -> int:
        """Number of baselines (cross-correlations)."""
        return len(self.antpairs)

    @property
    def Nfreqs(self) -> int:
        """Number of channels."""
        return len(self.freqs)

    @property
    def Ntimes(self) -> int:
        """Number of integrations."""
        return len(self.times)

    @property
    def Npols(self) -> int:
        """Number of polarisations."""
        return len(self.pols)

    @property
    def is_copolar(self) -> bool:
        """Whether the first polarisation is of equal feeds, so that the power beam is real."""
        return are_copolar(self.pols[:1])

    @property
    def lst_hours(self) -> FloatArray:
        """Sidereal times in hours, (Ntimes,)."""
        return np.rad2deg(self.lsts) / 15 % 24

    @cached_property
    def antenna_index(self) -> IntArray:
        """Indices into ``antenna_numbers`` of each baseline's antennas, (Nbls, 2)."""
        order = np.argsort(self.antenna_numbers)
        return order[np.searchsorted(self.antenna_numbers, self.antpairs, sorter=order)]

    @property
    def bl_vectors(self) -> FloatArray:
        """Baseline vectors pos(ant2) - pos(ant1), (Nbls, 3) in metres ENU."""
        one, two = self.antenna_index.T
        return self.antpos[two] - self.antpos[one]


@dataclass(frozen=True)
class Visibilities:
    """Visibilities and their weights for a rectangle of times x baselines.

    Attributes
    ----------
    data : ndarray of complex, (Nfreqs, Ntimes, Nbls, Npols)
        Jy.
    inv_noise_var : ndarray, same shape
        1/sigma^2 in Jy^-2 with E|n|^2 = sigma^2; zero where flagged.
    """

    data: ComplexArray
    inv_noise_var: FloatArray
