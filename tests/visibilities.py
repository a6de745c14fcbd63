"""Visibility files for tests, made with pyuvdata and not with the package."""

from __future__ import annotations

import warnings

import numpy as np
from astropy.coordinates import EarthLocation
from pyuvdata import Telescope, UVCal, UVData

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.data.partition import Tile

SECOND = 1 / 86400
TIMES = 2459866.2 + 10 * SECOND * np.arange(6)
NUMBERS = (3, 7, 11, 20, 41)
LOCATION = EarthLocation.from_geodetic(lon=21.4283, lat=-30.7215, height=1051.69)
# Metres; nothing lies on a round number or a symmetry axis.
ENU = np.array(
    [
        [0.1, -0.2, 0.03],
        [14.61, 0.37, -0.11],
        [7.29, 12.65, 0.21],
        [-31.3, 87.9, 1.7],
        [123.4, -55.1, -2.3],
    ]
)
# Not sorted, and one baseline from the higher to the lower number.
CROSS = ((3, 7), (20, 11), (3, 11), (7, 41), (3, 41), (7, 20))
AUTOS = tuple((ant, ant) for ant in NUMBERS)


def ecef_from_enu(enu: np.ndarray) -> np.ndarray:
    """Rotate to relative ECEF in extended precision."""
    lon = np.longdouble(LOCATION.lon.rad)
    lat = np.longdouble(LOCATION.lat.rad)
    east, north, up = enu.astype(np.longdouble).T
    outward = np.cos(lat) * up - np.sin(lat) * north
    x = np.cos(lon) * outward - np.sin(lon) * east
    y = np.sin(lon) * outward + np.cos(lon) * east
    z = np.cos(lat) * north + np.sin(lat) * up
    return np.stack([x, y, z], axis=1).astype(float)


def make_uvdata(
    *,
    times: np.ndarray | None = None,
    antpairs: tuple[tuple[int, int], ...] = CROSS + AUTOS,
    pols: tuple[int, ...] = (-5, -6),
    freqs: np.ndarray | None = None,
    x_orientation: str | None = "east",
    enu: np.ndarray = ENU,
    seed: int = 1,
) -> UVData:
    """Make a drift scan: random visibilities, positive autocorrelations, a few flags, varied nsamples."""
    times = TIMES if times is None else times
    freqs = 120e6 + 1e6 * np.arange(4) if freqs is None else freqs
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of feeds without direction
        uv = _new_uvdata(times, antpairs, pols, freqs, x_orientation, enu)
    rng = np.random.default_rng(seed)
    shape = uv.data_array.shape
    uv.data_array = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    auto = uv.ant_1_array == uv.ant_2_array
    uv.data_array[auto] = 1000 + 100 * np.abs(uv.data_array[auto])
    uv.flag_array = rng.random(shape) < 0.1
    # Exact in the single precision of the format.
    uv.nsample_array = rng.integers(1, 9, size=shape) / 4
    return uv


def _new_uvdata(times, antpairs, pols, freqs, x_orientation, enu) -> UVData:
    telescope = Telescope.new(
        "made",
        LOCATION,
        antenna_positions=ecef_from_enu(enu),
        antenna_numbers=list(NUMBERS),
        antenna_names=[f"A{number}" for number in NUMBERS],
        instrument="made",
        mount_type="fixed",
        update_from_known=False,
        **({"x_orientation": x_orientation} if x_orientation else {}),
    )
    return UVData.new(
        freq_array=freqs,
        polarization_array=np.array(pols),
        times=times,
        telescope=telescope,
        antpairs=antpairs,
        do_blt_outer=True,
        time_axis_faster_than_bls=False,
        integration_time=10.0,
        channel_width=1e6,
        vis_units="Jy",
        empty=True,
        update_telescope_from_known=False,
    )


def make_uvcal(uv, *, times=TIMES, jones=(-5, -6), convention="divide", numbers=NUMBERS, **given) -> UVCal:
    """Make random gains, a few flagged, for the antennas and channels of ``uv``."""
    cal = UVCal.new(
        cal_style="redundant",
        gain_convention=convention,
        jones_array=np.array(jones),
        telescope=uv.telescope.copy(),
        freq_array=uv.freq_array,
        channel_width=uv.channel_width,
        ant_array=np.array(numbers),
        update_telescope_from_known=False,
        empty=True,
        **({"time_array": times, "integration_time": 10.0} | given),
    )
    rng = np.random.default_rng(7)
    shape = cal.gain_array.shape
    cal.gain_array = rng.uniform(0.5, 2, shape) * np.exp(1j * rng.uniform(0, 2 * np.pi, shape))
    cal.flag_array = rng.random(shape) < 0.05
    return cal


def expected(uv: UVData, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return data (zero where flagged), flags and nsamples of all baselines through pyuvdata's getters."""
    arrays = []
    for getter in (uv.get_data, uv.get_flags, uv.get_nsamples):
        by_pol = [
            [getter(ant_1, ant_2, pol, force_copy=True).T for ant_1, ant_2 in observation.antpairs.tolist()]
            for pol in observation.pols
        ]
        arrays.append(np.array(by_pol).transpose(2, 3, 1, 0))
    data, flags, nsamples = arrays
    return np.where(flags, 0, data), flags, nsamples


def whole(observation: Observation) -> Tile:
    """All rows as one tile."""
    return Tile(np.arange(observation.Ntimes), np.arange(observation.Nbls))
