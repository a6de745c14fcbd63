"""The samples of a beam file: read through pyuvdata, and refused where they are not those of a whole beam."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from astropy_healpix import HEALPix
from pyuvdata import UVBeam

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import check_file, reading
from hydrabeam_mpi.model.bases.rings import FEWEST_AZIMUTHS, LARGEST_GAP

LARGEST_STEP = 16.0
"""Largest ratio of peak and next sample: what a Gaussian falls by within its own full width at half maximum.

Samples farther apart than that do not describe a beam, and a single one that stands out by more is no part of it.
"""
_TOLERANCE = 1e-6


def read_uvbeam(path: Path) -> UVBeam:
    """Read a beam of any kind that pyuvdata knows.

    Raises
    ------
    InputError
        If there is no such file, or it is no E-field or power beam.
    """
    check_file(path, field="[beam] source")
    if path.suffix.lower() == ".txt":
        raise InputError(
            "a text file, and those of CST tell neither their frequency nor their feed",
            file=path,
            field="[beam] source",
            remedy="name the settings yaml that lists them with both, as pyuvdata has it",
        )
    remedy = (
        "give a file that pyuvdata reads, or write this one again; a power beam with one polarisation or all four, as "
        "pyuvdata writes beamfits of two that it does not read"
    )
    with reading(path, "a beam", remedy=remedy):
        return usable_uvbeam(UVBeam.from_file(str(path)))


def usable_uvbeam(uvbeam: UVBeam) -> UVBeam:
    """Return a beam whose azimuths do not repeat, itself where they do not.

    Raises
    ------
    InputError
        If it is no E-field or power beam.
    """
    if uvbeam.beam_type not in ("efield", "power") or uvbeam.antenna_type != "simple":
        kind = f"{uvbeam.antenna_type} {uvbeam.beam_type}"
        raise InputError(f"a {kind} beam is not supported", remedy="give an E-field or power beam")
    azimuths = uvbeam.axis1_array
    if azimuths is not None and np.isclose(azimuths[-1] - azimuths[0], 2 * np.pi):
        # The last azimuth repeats the first, which would spoil interpolation across it.
        uvbeam = uvbeam.select(axis1_inds=np.arange(len(azimuths) - 1), inplace=False)
    return uvbeam


def pixel_directions(uvbeam: UVBeam, path: Path) -> tuple[FloatArray, FloatArray]:
    """Return za and az of the pixels, (Npix,) each, in the order of the flattened data.

    Raises
    ------
    InputError
        If they are on no az_za or HEALPix grid from the zenith to the horizon and all around.

    Warns
    -----
    UserWarning
        If HEALPix pixels contradict their nside.
    """
    system = uvbeam.pixel_coordinate_system
    if system not in ("az_za", "healpix"):
        raise InputError(f"pixels in {system} are not supported", file=path, remedy="convert it to az_za or HEALPix")
    if system == "healpix":
        _mend_nside(uvbeam, path)
    with reading(path, "a beam"):
        _check_grid(uvbeam, path)
        if system == "az_za":
            az, za = np.meshgrid(uvbeam.axis1_array, uvbeam.axis2_array)
            return za.ravel(), az.ravel()
        lon, lat = HEALPix(uvbeam.nside, uvbeam.ordering).healpix_to_lonlat(uvbeam.pixel_array)
        return np.pi / 2 - lat.to_value("rad"), lon.to_value("rad")


def _mend_nside(uvbeam: UVBeam, path: Path) -> None:
    """Take the nside that the pixels tell, where they are the whole sky at another than the header says."""
    whole_sky = round(np.sqrt(uvbeam.Npixels / 12))
    if uvbeam.nside != whole_sky and np.array_equal(uvbeam.pixel_array, np.arange(12 * whole_sky**2)):
        warnings.warn(
            f"{path}: nside is said to be {uvbeam.nside}, but its pixels are the whole sky at nside "
            f"{whole_sky}, which is used",
            stacklevel=6,
        )
        uvbeam.nside = whole_sky


def _check_grid(uvbeam: UVBeam, path: Path) -> None:
    """Make sure that the samples go all around and from the zenith to the horizon."""
    if uvbeam.pixel_coordinate_system == "az_za":
        _check_azimuths(np.asarray(uvbeam.axis1_array, dtype=float), path)
        _check_zenith_angles(np.asarray(uvbeam.axis2_array, dtype=float), path)
    else:
        _check_healpix(uvbeam, path)


def _check_azimuths(az: FloatArray, path: Path) -> None:
    field, remedy = "axis1_array", "give a beam on the whole circle"
    if len(az) < FEWEST_AZIMUTHS:
        told = f"{len(az)} azimuths; at least {FEWEST_AZIMUTHS} are needed"
        raise InputError(told, file=path, field=field, remedy=remedy)
    gaps = np.diff(az, append=az[0] + 2 * np.pi)
    if not np.all(gaps > 0):
        told = "the azimuths do not ascend within one turn"
        raise InputError(told, file=path, field=field, remedy="sort them, and leave out what is there twice")
    widest = int(np.argmax(gaps))
    if gaps[widest] > LARGEST_GAP * 2 * np.pi / len(az):
        first, last = np.round(np.rad2deg([az[widest], az[widest] + gaps[widest]]), 3)
        told = f"no azimuths between {first:g} and {last - 360 if last > 360 else last:g} deg"
        raise InputError(told, file=path, field=field, remedy=remedy)


def _check_zenith_angles(za: FloatArray, path: Path) -> None:
    field, remedy = "axis2_array", "give a beam from the zenith to the horizon"
    steps = np.diff(za)
    if len(za) < 2 or not np.all(steps > 0) or za[0] < -_TOLERANCE or za[-1] > np.pi + _TOLERANCE:
        told = "the zenith angles do not ascend within 0 and 180 deg"
        raise InputError(told, file=path, field=field, remedy="sort them, and leave out what is there twice")
    if za[0] > steps.max() + _TOLERANCE:
        told = f"the samples begin at a zenith angle of {np.rad2deg(za[0]):.4g} deg"
        raise InputError(told, file=path, field=field, remedy=remedy)
    if za[-1] < np.pi / 2 - _TOLERANCE:
        told = f"the samples end at a zenith angle of {np.rad2deg(za[-1]):.4g} deg, above the horizon"
        raise InputError(told, file=path, field=field, remedy=remedy)


def _check_healpix(uvbeam: UVBeam, path: Path) -> None:
    field, healpix = "pixel_array", HEALPix(uvbeam.nside, uvbeam.ordering)
    pixels = np.asarray(uvbeam.pixel_array)
    if len(np.unique(pixels)) < len(pixels) or pixels.min() < 0 or pixels.max() >= healpix.npix:
        told = f"a pixel is there twice, or is none of the {healpix.npix} of nside {uvbeam.nside}"
        raise InputError(told, file=path, field=field, remedy="correct the file")
    _, latitude = healpix.healpix_to_lonlat(np.arange(healpix.npix))
    above = np.flatnonzero(latitude.to_value("rad") >= 0)
    lacking = len(above) - np.isin(above, pixels).sum()
    if lacking:
        told = f"{lacking} of {len(above)} pixels above the horizon are missing"
        raise InputError(told, file=path, field=field, remedy="give a beam on the whole sky")


def check_values(values: Array, what: str, path: Path) -> None:
    """Make sure that samples above the horizon, (Npix,), are numbers.

    Raises
    ------
    InputError
        If one is NaN, infinite or beyond `LARGEST`.
    """
    wrong = np.count_nonzero(~(np.abs(values) <= LARGEST))
    if wrong:
        told = f"{wrong} of {len(values)} samples of {what} above the horizon are NaN, infinite or larger than any beam"
        raise InputError(told, file=path, field="data_array", remedy="give a beam without them")


def check_peak(values: FloatArray, what: str, path: Path) -> None:
    """Make sure that a co-polarised power beam has a positive peak that is not one sample far above all others.

    ``values`` is (Npoints,).

    Raises
    ------
    InputError
        If no sample is positive, or one is `LARGEST_STEP` times any other.
    """
    field = "data_array"
    if not len(values) or not values.max() > 0:
        told, remedy = f"{what} has no positive value above the horizon", "give a beam that receives something"
        raise InputError(told, file=path, field=field, remedy=remedy)
    if len(values) > 1:
        second, peak = np.partition(values, -2)[-2:]
        if peak > LARGEST_STEP * second:
            told = f"one sample of {what}, {peak:.3g}, is more than {LARGEST_STEP:g} times as large as any other"
            remedy = "correct that sample, or give the beam on a finer grid"
            raise InputError(told, file=path, field=field, remedy=remedy)
