"""Diffuse emission: the global sky model of Zheng et al. (2017, MNRAS 464, 3486) at its 5 degree resolution.

Six component maps (galactic HEALPix, nside 64, nested) are summed with weights that depend on frequency:
I(nu) = s(nu) sum_i w_i(nu) M_i in MJy/sr, where log s and w_i are linear in log nu between the 29 tabulated
frequencies.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from astropy import units
from astropy.coordinates import SkyCoord
from astropy_healpix import healpix_to_lonlat, nside_to_npix, nside_to_pixel_area

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import check_file, reading
from hydrabeam_mpi.model.sky import Sky

NSIDE = 64
JY_PER_MJY = 1e6


def read_gsm2016(folder: Path, freqs: FloatArray) -> Sky:
    """Read the diffuse sky as one point source a pixel.

    Parameters
    ----------
    folder : Path
        With ``lowres_maps.txt`` and ``spectra.txt`` of the public model.
    freqs : ndarray, (Nfreqs,)
        Hz, from 10 MHz to 5 THz.

    Returns
    -------
    Sky
        12 `NSIDE`^2 unnamed sources in ICRS.

    Raises
    ------
    InputError
        If a file is missing or not of the expected shape, or ``freqs`` are out of range.
    """
    maps = _read_table(folder / "lowres_maps.txt", columns=nside_to_npix(NSIDE))
    spectra = _read_table(folder / "spectra.txt")
    if len(spectra) != len(maps) + 2:
        message = f"{len(spectra)} rows do not fit {len(maps)} component maps"
        raise InputError(message, file=folder / "spectra.txt", remedy="fetch both files anew")
    weights = _weights(spectra, freqs, folder / "spectra.txt")
    pixel_area = nside_to_pixel_area(NSIDE).to_value("sr")
    lon, lat = healpix_to_lonlat(np.arange(maps.shape[1]), NSIDE, order="nested")
    centres = SkyCoord(lon, lat, frame="galactic").icrs
    return Sky(centres.ra.rad, centres.dec.rad, weights @ maps * (JY_PER_MJY * pixel_area))


def _weights(spectra: FloatArray, freqs: FloatArray, path: Path) -> FloatArray:
    """Interpolate s(nu) w_i(nu), (Nfreqs, Ncomponents)."""
    if not (np.all(np.diff(spectra[0]) > 0) and np.all(spectra[:2] > 0)):
        told = "its frequencies do not ascend, or its scale is not positive"
        raise InputError(told, file=path, remedy="fetch the file anew")
    listed = spectra[0] * units.GHz.to("Hz")
    outside = (freqs < listed[0]) | (freqs > listed[-1])
    if outside.any():
        message = f"no diffuse emission at {freqs[outside][0] / 1e6:g} MHz"
        raise InputError(message, file=path, remedy="select frequencies from 10 MHz to 5 THz")
    x, known = np.log(freqs), np.log(listed)
    scale = np.exp(np.interp(x, known, np.log(spectra[1])))
    return np.stack([scale * np.interp(x, known, weight) for weight in spectra[2:]], axis=1)


def _read_table(path: Path, columns: int | None = None) -> FloatArray:
    remedy = "fetch the file anew"
    check_file(path, field="[sky] diffuse")
    with reading(path, "a table of numbers", remedy=remedy):
        table: FloatArray = np.loadtxt(path, ndmin=2)
    if columns is not None and table.shape[1] != columns:
        message = f"{table.shape[1]} pixels, not {columns}"
        raise InputError(message, file=path, remedy=remedy)
    if not np.all(np.abs(table) <= LARGEST):
        raise InputError("numbers that are NaN, infinite or absurdly large", file=path, remedy=remedy)
    return table
