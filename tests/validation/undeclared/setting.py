"""The experiment: antennas, times, channels and the catalogue, all drawn by a seed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from astropy import units
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time
from numpy.typing import NDArray

from tests.validation.undeclared.basis import BASES, Basis
from tests.validation.undeclared.beams import REFERENCE_FREQ, Shape

FloatArray = NDArray[np.float64]
LOCATION = EarthLocation.from_geodetic(lon=21.4283, lat=-30.7215, height=1051.69)
SPACING = 14.6
SIDEREAL_DAY = 0.99726957


@dataclass(frozen=True)
class Catalogue:
    """Unpolarised point sources: ICRS in radians, Jy at 150 MHz, and a spectral index."""

    ra: FloatArray
    dec: FloatArray
    flux: FloatArray
    index: FloatArray

    def at(self, freq: float) -> FloatArray:
        """Return the fluxes at a frequency, Jy."""
        return self.flux * (freq / REFERENCE_FREQ) ** self.index

    def joined(self, other: Catalogue) -> Catalogue:
        """Return both lists."""
        names = ("ra", "dec", "flux", "index")
        return Catalogue(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))

    def select(self, which: NDArray[np.bool_] | NDArray[np.int_]) -> Catalogue:
        """Return some of the sources."""
        return Catalogue(self.ra[which], self.dec[which], self.flux[which], self.index[which])


@dataclass(frozen=True)
class Setting:
    """What is observed, as the files will say it.

    Attributes
    ----------
    antpos : ndarray, (Nants, 3)
        Metres ENU.
    numbers : ndarray of int, (Nants,)
    antpairs : ndarray of int, (Nbls, 2)
        Indices of antennas; the visibility is that of the first times the conjugate of the second.
    freqs : ndarray, (Nfreqs,)
        Hz.
    times : ndarray, (Ntimes,)
        JD.
    catalogue : Catalogue
    model_shape : Shape
        The job's beam.
    snr : float
        Root mean square of the visibilities over the noise.
    basis : Basis
        The job's.
    radiometer : bool
        Whether the job takes the noise from the autocorrelations.
    """

    antpos: FloatArray
    numbers: NDArray[np.int_]
    antpairs: NDArray[np.int_]
    freqs: FloatArray
    times: FloatArray
    catalogue: Catalogue
    model_shape: Shape
    snr: float
    basis: Basis = BASES["study"]
    radiometer: bool = False

    @property
    def n_ants(self) -> int:
        """Number of antennas."""
        return len(self.numbers)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Nfreqs, Ntimes, Nbls)."""
        return len(self.freqs), len(self.times), len(self.antpairs)

    @cached_property
    def bl_vectors(self) -> FloatArray:
        """Second minus first position, (Nbls, 3), metres."""
        return self.antpos[self.antpairs[:, 1]] - self.antpos[self.antpairs[:, 0]]

    @cached_property
    def seconds(self) -> FloatArray:
        """Seconds since the first time, (Ntimes,)."""
        return (self.times - self.times[0]) * 86400


@dataclass(frozen=True)
class Plan:
    """What an effect needs of the setting.

    Attributes
    ----------
    n_freqs : int
        One channel, or several over ``bandwidth`` Hz.
    n_times : int
    cadence : float
        Seconds between times.
    nights : int
        Over which the times are spread, at the same sidereal times in each.
    wide : bool
        Whether the element is wide enough to see its horizon.
    bandwidth : float
        Hz.
    n_sources : int
        In the catalogue.
    spacing : float
        Metres between neighbours.
    rows : tuple of int
        Antennas in each row of the hexagon.
    radiometer : bool
        Whether the job takes the noise from the autocorrelations.
    """

    n_freqs: int = 1
    n_times: int = 24
    cadence: float = 750.0
    nights: int = 1
    wide: bool = False
    bandwidth: float = 16e6
    n_sources: int = 300
    spacing: float = SPACING
    rows: tuple[int, ...] = (3, 4, 5, 4, 3)
    radiometer: bool = False


def hexagon(spacing: float, rows: tuple[int, ...]) -> FloatArray:
    """Lay out a hexagon, metres ENU."""
    return np.array(
        [
            (spacing * (column - (length - 1) / 2), spacing * np.sqrt(0.75) * (row - (len(rows) - 1) / 2), 0.0)
            for row, length in enumerate(rows)
            for column in range(length)
        ]
    )


def draw_setting(rng: np.random.Generator, plan: Plan, basis: Basis = BASES["study"]) -> Setting:
    """Draw an experiment."""
    antpos = hexagon(plan.spacing, plan.rows)
    numbers = np.sort(rng.choice(100, len(antpos), replace=False))
    one, two = np.triu_indices(len(antpos), 1)
    # Half of the baselines are stored the other way round, as files have them.
    turned = rng.random(len(one)) < 0.5
    antpairs = np.where(turned[:, None], np.stack([two, one], 1), np.stack([one, two], 1))
    centre = rng.uniform(145e6, 160e6)
    freqs = centre + plan.bandwidth * (np.arange(plan.n_freqs) - (plan.n_freqs - 1) / 2) / max(plan.n_freqs, 1)
    night, since = np.divmod(np.arange(plan.n_times), plan.n_times // plan.nights)
    times = 2459866.0 + rng.uniform(0.2, 0.7) + plan.cadence * since / 86400 + SIDEREAL_DAY * night
    width = 0.5 if plan.wide else 0.22
    return Setting(
        antpos=antpos,
        numbers=numbers,
        antpairs=antpairs,
        freqs=freqs,
        times=times,
        catalogue=draw_catalogue(rng, plan.n_sources),
        model_shape=Shape(width=(width, width), pedestal=0.02, breadth=0.5),
        snr=float(np.exp(rng.uniform(np.log(50), np.log(300)))),
        basis=basis,
        radiometer=plan.radiometer,
    )


def draw_catalogue(rng: np.random.Generator, n: int) -> Catalogue:
    """Draw sources evenly over the sphere, log-flat between 0.5 and 50 Jy."""
    return Catalogue(
        ra=rng.uniform(0, 2 * np.pi, n),
        dec=np.arcsin(rng.uniform(-1, 1, n)),
        flux=np.exp(rng.uniform(np.log(0.5), np.log(50.0), n)),
        index=rng.normal(-0.8, 0.2, n),
    )


def altaz(ra: FloatArray, dec: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth from East through North, radians, as astropy has them without refraction."""
    frame = AltAz(obstime=Time(time, format="jd"), location=LOCATION)
    seen = SkyCoord(ra * units.rad, dec * units.rad, frame="icrs").transform_to(frame)
    return np.pi / 2 - seen.alt.rad, (np.pi / 2 - seen.az.rad) % (2 * np.pi)


def icrs(za: FloatArray, az: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
    """Return right ascension and declination of apparent directions, the inverse of `altaz`."""
    seen = SkyCoord(
        AltAz(
            az=(np.pi / 2 - az) * units.rad,
            alt=(np.pi / 2 - za) * units.rad,
            obstime=Time(time, format="jd"),
            location=LOCATION,
        )
    ).icrs
    return seen.ra.rad, seen.dec.rad
