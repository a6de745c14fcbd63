"""The files that a user would have: visibilities, a catalogue, a beam and a job."""

from __future__ import annotations

import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units
from astropy.coordinates import SkyCoord
from numpy.typing import NDArray
from pyradiosky import SkyModel
from pyuvdata import Telescope, UVData

from tests.validation.undeclared.beams import REFERENCE_FREQ, write_beamfits
from tests.validation.undeclared.setting import LOCATION, Catalogue, FloatArray, Setting
from tests.validation.undeclared.truth import ComplexArray

CHANNEL_WIDTH, INTEGRATION = 1e5, 10.0

JOB = """\
name = "undeclared"
seed = {seed}

[data]
files = ["data.uvh5"]
polarization = "{pol}"

[noise]
{noise}

[holdout]
kind = "times"
every = 2

[sky]
kind = "catalogue"
file = "catalogue.skyh5"
reference_freq = "150 MHz"

[beam]
source = "beam.beamfits"

[basis]
kind = "fourier-bessel"
form = "{form}"
n_modes = {n_modes}
k_max = {k_max}
m_max = {m_max}
edge = "{edge:g} deg"
boundary = "{boundary}"

[prior]
kind = "fraction"
fraction = 0.1
floor = 0.1

[output]
draws = 0
"""


def write_all(
    folder: Path, setting: Setting, sigma: float, data: dict[str, ComplexArray], autos: FloatArray, seed: int
) -> None:
    """Write data.uvh5, catalogue.skyh5, beam.beamfits and job.toml.

    Parameters
    ----------
    folder : Path
    setting : Setting
    sigma : float
        Jy, what the job says of the noise.
    data : dict of str to ndarray, (Nfreqs, Ntimes, Nbls)
        By polarisation: "ee", "nn", "en", "ne". The job asks for the first.
    autos : ndarray, (Nfreqs, Ntimes, Nants)
        Autocorrelations, of both feeds.
    seed : int
    """
    folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_visibilities(folder / "data.uvh5", setting, data, autos)
        write_catalogue(folder / "catalogue.skyh5", setting.catalogue)
        write_beamfits(folder / "beam.beamfits", setting.model_shape, setting.freqs)
    constant = f'kind = "constant"\nsigma = "{sigma:.17g} Jy"'
    noise = 'kind = "autocorrelations"' if setting.radiometer else constant
    basis = asdict(setting.basis) | {"n_modes": setting.basis.n_modes}
    job = JOB.format(seed=seed, pol=next(iter(data)), noise=noise, **basis)
    (folder / "job.toml").write_text(job)


def write_visibilities(path: Path, setting: Setting, data: dict[str, ComplexArray], autos: FloatArray) -> None:
    """Write a uvh5 file with cross- and autocorrelations, time by time."""
    up, east, north = _axes()
    antpos = setting.antpos @ np.stack([east, north, up])
    telescope = Telescope.new(
        name="undeclared",
        location=LOCATION,
        antenna_positions=antpos,
        antenna_names=[f"A{number}" for number in setting.numbers],
        antenna_numbers=setting.numbers,
        instrument="undeclared",
        mount_type="fixed",
        x_orientation="east",
        update_from_known=False,
    )
    antpairs = np.concatenate([setting.numbers[setting.antpairs], np.repeat(setting.numbers[:, None], 2, axis=1)])
    numbers = {"ee": -5, "nn": -6, "en": -7, "ne": -8}

    def rows(pol: str) -> NDArray[Any]:
        """Return (Ntimes x Nbls, Nfreqs) of one polarisation; cross-hand autocorrelations are left at zero."""
        own = autos if pol in ("ee", "nn") else np.zeros_like(autos)
        values = np.concatenate([data[pol], own], axis=2)
        return values.transpose(1, 2, 0).reshape(-1, len(setting.freqs))

    values = np.stack([rows(pol) for pol in data], axis=-1).astype(complex)
    uv = UVData.new(
        freq_array=setting.freqs,
        polarization_array=np.array([numbers[pol] for pol in data]),
        times=setting.times,
        telescope=telescope,
        antpairs=antpairs,
        do_blt_outer=True,
        time_axis_faster_than_bls=False,
        integration_time=INTEGRATION,
        channel_width=CHANNEL_WIDTH,
        update_telescope_from_known=False,
        data_array=values,
        flag_array=np.zeros(values.shape, bool),
        nsample_array=np.ones(values.shape),
        vis_units="Jy",
        pol_convention="sum",
    )
    uv.write_uvh5(str(path), clobber=True)


def _axes() -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return up, east and north at the array, geocentric."""
    lon, lat = LOCATION.lon.rad, LOCATION.lat.rad
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    return up, east, np.cross(up, east)


def write_catalogue(path: Path, catalogue: Catalogue) -> None:
    """Write a skyh5 file of sources with power laws."""
    n = len(catalogue.ra)
    stokes = np.zeros((4, 1, n))
    stokes[0, 0] = catalogue.flux
    model = SkyModel(
        name=[f"source {number}" for number in range(n)],
        skycoord=SkyCoord(catalogue.ra * units.rad, catalogue.dec * units.rad, frame="icrs"),
        stokes=stokes * units.Jy,
        spectral_type="spectral_index",
        reference_frequency=np.full(n, REFERENCE_FREQ) * units.Hz,
        spectral_index=catalogue.index,
    )
    model.write_skyh5(str(path), clobber=True)
