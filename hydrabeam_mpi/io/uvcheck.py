"""Whether what a file says of its visibilities can be so, and whether the model can describe such data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from astropy.coordinates import EarthLocation
from pyuvdata import UVData
from pyuvdata.utils import polnum2str

from hydrabeam_mpi.data.limits import EARTH_DIAMETER, FIRST_JD, LAST_JD, MAX_HEIGHT, RADIO
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import reading

CORRECT = "correct the file"
# Two integrations or channels are of the same data where more than this part of the shorter lies in the other. Half is
# not enough: headers of files that were thinned out state distances for widths.
SAME_DATA = 0.75
MJD_ZERO = 2400000.5
# The arrays that the package uses. How long each is to be, pyuvdata knows.
OF_DATA = (
    "time_array",
    "lst_array",
    "integration_time",
    "ant_1_array",
    "ant_2_array",
    "freq_array",
    "channel_width",
    "polarization_array",
)
OF_TELESCOPE = ("antenna_numbers", "antenna_positions")


def check_metadata(uv: UVData, path: Path) -> None:
    """Make sure that the metadata of a file fit together and can be those of an observation on Earth.

    Raises
    ------
    InputError
        That names what cannot be so, or what the forward model cannot describe.
    """
    _check_supported(uv, path)
    for owner, names in ((uv, OF_DATA), (uv.telescope, OF_TELESCOPE)):
        for name in names:
            _check_array(owner, name, path)
    if len(uv.telescope.antenna_names) != len(uv.telescope.antenna_numbers):
        raise _wrong(path, "antenna_names", f"{len(uv.telescope.antenna_names)} names of antennas, not one for each")
    if uv.data_array is None and h5py.is_hdf5(path):
        _check_samples(uv, path)
    _check_times(uv, path)
    _check_place(uv, path)
    _check_channels(uv, path)
    if uv.Nspws > 1:
        _check_windows(uv, path)
    _check_polarizations(uv, path)
    if len(np.unique(uv.polarization_array)) < len(uv.polarization_array):
        raise _wrong(path, "polarization_array", "a polarisation stands twice")


def _wrong(path: Path, field: str, message: str, remedy: str = CORRECT) -> InputError:
    return InputError(message, file=path, field=field, remedy=remedy)


def _check_supported(uv: UVData, path: Path) -> None:
    """Refuse by name what the forward model cannot describe."""
    if uv.flex_spw_polarization_array is not None:
        remedy = "convert it with UVData.remove_flex_pol()"
        raise InputError("the polarisation varies between spectral windows", file=path, remedy=remedy)
    if uv.vis_units == "K str":
        remedy = "convert it with UVData.kelvin_to_jansky()"
        raise _wrong(path, "vis_units", "visibilities in K sr, not Jy", remedy)
    if not isinstance(uv.telescope.location, EarthLocation):
        raise InputError("the telescope is not on Earth", file=path, field="telescope_frame", remedy=CORRECT)


def _check_array(owner: Any, name: str, path: Path) -> None:
    """Make sure that an array has numbers, and as many as the header says."""
    parameter = getattr(owner, f"_{name}")
    array = np.asarray(parameter.value)
    if array.dtype.kind not in "iuf":
        raise _wrong(path, name, "not an array of numbers")
    expected = parameter.expected_shape(owner)
    if array.shape != expected:
        sizes = (" x ".join(map(str, shape)) or "1" for shape in (array.shape, expected))
        raise _wrong(path, name, "{} numbers, where the header says {}".format(*sizes), "write the file again")


def _check_samples(uv: UVData, path: Path) -> None:
    """Make sure that a uvh5 file has as many samples as its header says."""
    expected = (uv.Nblts, uv.Nfreqs, uv.Npols)
    with reading(path, "uvh5"), h5py.File(path, "r") as file:
        for name in ("visdata", "flags", "nsamples"):
            shape = file["Data"][name].shape if name in file["Data"] else ()
            # Older files have an axis of one spectral window.
            if shape[:1] + shape[-2:] != expected:
                sizes = (" x ".join(map(str, shape)) or "none" for shape in (shape, expected))
                raise _wrong(path, f"Data/{name}", "{} samples, where the header says {}".format(*sizes))


def _check_channels(uv: UVData, path: Path) -> None:
    """Make sure that every channel lies in the range of radio waves, with both of its edges."""
    freqs, widths = np.asarray(uv.freq_array), np.abs(np.asarray(uv.channel_width))
    possible = (freqs >= RADIO[0]) & (freqs <= RADIO[1])
    if not possible.all():
        raise _wrong(path, "freq_array", f"a frequency of {freqs[~possible][0]:g} Hz")
    possible = widths <= 2 * freqs
    if not possible.all():
        channel = np.flatnonzero(~possible)[0]
        told = f"a channel of {widths[channel]:g} Hz at {freqs[channel] / 1e6:g} MHz, which would begin below 0 Hz"
        raise _wrong(path, "channel_width", told)


def _check_windows(uv: UVData, path: Path) -> None:
    """Make sure that no channel of a spectral window is of the same data as one of another, be it averaged."""
    _check_array(uv, "flex_spw_id_array", path)
    order = np.argsort(uv.freq_array)
    freqs, widths, window = (
        np.asarray(array)[order] for array in (uv.freq_array, np.abs(uv.channel_width), uv.flex_spw_id_array)
    )
    in_both = (widths[1:] + widths[:-1]) / 2 - np.diff(freqs)
    twice = (window[1:] != window[:-1]) & (in_both > SAME_DATA * np.minimum(widths[1:], widths[:-1]))
    if twice.any():
        one = np.flatnonzero(twice)[0]
        told = f"windows {window[one]} and {window[one + 1]} both have the data at {freqs[one] / 1e6:.6f} MHz"
        raise _wrong(path, "spw_array", told, "keep one with UVData.select(spws=[...])")


def _check_polarizations(uv: UVData, path: Path) -> None:
    """Make sure that each polarisation is one that there is."""
    for code in uv.polarization_array:
        try:
            polnum2str(int(code))
        except KeyError:
            raise _wrong(path, "polarization_array", f"no polarisation has the code {int(code)}") from None


def _check_times(uv: UVData, path: Path) -> None:
    """Make sure that times are Julian dates, sidereal times known, and integrations take time."""
    times = np.asarray(uv.time_array)
    possible = _are_dates(times)
    if not possible.all():
        remedy = "write them as Julian dates (UTC)"
        if _are_dates(times + MJD_ZERO).all():
            remedy = "they look like modified Julian dates: add 2400000.5"
        raise _wrong(path, "time_array", f"{times[~possible][0]:.10g} is no Julian date from 1962 to 2100", remedy)
    lsts = np.asarray(uv.lst_array)
    if not np.isfinite(lsts).all():
        remedy = "set them with UVData.set_lsts_from_time_array()"
        raise _wrong(path, "lst_array", f"a sidereal time that is {lsts[~np.isfinite(lsts)][0]:g}", remedy)
    seconds = np.asarray(uv.integration_time)
    # Of integrations of 0 s the noise alone cannot be told, and only where it is asked for.
    possible = (seconds >= 0) & np.isfinite(seconds)
    if not possible.all():
        raise _wrong(path, "integration_time", f"an integration of {seconds[~possible][0]:g} s")


def _are_dates(times: FloatArray) -> Any:
    return (times >= FIRST_JD) & (times <= LAST_JD)


def _check_place(uv: UVData, path: Path) -> None:
    """Make sure that telescope and antennas stand on Earth."""
    location = uv.telescope.location
    height = location.height.to_value("m")
    if not abs(height) <= MAX_HEIGHT:
        # Of a place that is not finite, latitude and longitude say nothing.
        known = f"latitude {location.lat.deg:.6g} deg, longitude {location.lon.deg:.6g} deg, height {height:.6g} m"
        where = known if np.isfinite(height) else "a coordinate is NaN or infinite"
        remedy = "correct where the file says that the telescope stands"
        raise _wrong(path, "telescope_location", f"not a place on Earth ({where})", remedy)
    # Antennas without a position are told where they are used.
    beyond = np.abs(np.asarray(uv.telescope.antenna_positions)) > EARTH_DIAMETER
    if beyond.any():
        antenna, axis = np.argwhere(beyond)[0]
        number, far = uv.telescope.antenna_numbers[antenna], uv.telescope.antenna_positions[antenna, axis]
        raise _wrong(path, "antenna_positions", f"antenna {number} stands {abs(far):.3g} m from the telescope")
