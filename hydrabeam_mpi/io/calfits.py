"""Gains written as a calfits file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyuvdata import UVCal
from pyuvdata.utils import jstr2num

from hydrabeam_mpi.data.observation import ComplexArray, Observation
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.io.uvdata import feeds_of
from hydrabeam_mpi.io.uvwrite import telescope_of


def write_calfits(path: Path, observation: Observation, gains: ComplexArray, history: str) -> None:
    """Write gains that are the same for all feeds, by which data are divided: V / (g_i g_j*).

    Parameters
    ----------
    path : Path
        Replaced if it exists.
    observation : Observation
        Their antennas, channels, times and feeds.
    gains : ndarray of complex, (Nfreqs, Ntimes, Nants)
    history : str
    """
    telescope, orientation = telescope_of(observation)
    feeds = feeds_of(observation.pols)
    shape = (observation.Nants, observation.Nfreqs, observation.Ntimes, len(feeds))
    values = np.broadcast_to(np.moveaxis(gains, 2, 0)[..., np.newaxis], shape).copy()
    with quiet():
        cal = UVCal.new(
            cal_style="redundant",
            gain_convention="divide",
            jones_array=np.array([jstr2num(2 * feed, **orientation) for feed in feeds]),
            telescope=telescope,
            ant_array=observation.antenna_numbers,
            time_array=observation.times,
            integration_time=observation.integration_time,
            freq_array=observation.freqs,
            channel_width=observation.channel_width,
            update_telescope_from_known=False,
            data={"gain_array": values, "flag_array": np.zeros(shape, bool), "quality_array": np.zeros(shape)},
            history=history,
            pol_convention="sum",
            gain_scale="Jy",
        )
        cal.write_calfits(str(path), run_check=False, clobber=True)
