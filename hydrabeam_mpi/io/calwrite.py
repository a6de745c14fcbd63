"""Gains written as a file of pyuvdata: calfits, or calh5 where that cannot hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyuvdata import UVCal
from pyuvdata.utils import jstr2num

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, Observation
from hydrabeam_mpi.io.feeds import UNKNOWN
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.io.uvdata import feeds_of
from hydrabeam_mpi.io.uvwrite import telescope_of
from hydrabeam_mpi.words import in_ascii

EVEN_WITHIN_DAYS = 1e-3 / 86400
EVEN_WITHIN_HZ = 1.0
"""Days and Hz by which pyuvdata takes times and channels as the same."""


def write_gains(
    folder: Path, observation: Observation, gains: ComplexArray, history: str, flags: BoolArray | None = None
) -> None:
    """Write gains that are the same for all feeds, by which data are divided: V / (g_i g_j*).

    ``gains.calfits`` holds channels and times that are evenly spaced, and of others only the first and how far the
    second is. Where they are not, as of several nights, ``gains.calh5`` is written instead.

    Both formats want to know where feeds point. Where the data do not tell x is written as East, and the history says
    so; the gains themselves are told by feed.

    Parameters
    ----------
    folder : Path
        A file in it is replaced.
    observation : Observation
        Their antennas, channels, times and feeds.
    gains : ndarray of complex, (Nfreqs, Ntimes, Nants)
    history : str
    flags : ndarray of bool, same shape as ``gains``, optional
    """
    telescope, orientation = telescope_of(observation)
    feeds = feeds_of(observation.pols)
    if telescope.feed_array is None:
        telescope.set_feeds_from_x_orientation("east", feeds=list(feeds))
        history += f"{UNKNOWN}\n"
    shape = (observation.Nants, observation.Nfreqs, observation.Ntimes, len(feeds))
    given = (gains, np.zeros(gains.shape, dtype=bool) if flags is None else flags)
    values, flagged = (np.broadcast_to(np.moveaxis(one, 2, 0)[..., np.newaxis], shape).copy() for one in given)
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
            data={"gain_array": values, "flag_array": flagged, "quality_array": np.zeros(shape)},
            history="\n".join(map(in_ascii, history.split("\n"))),
            # Of the data that they divide.
            pol_convention=observation.convention,
            gain_scale="Jy",
        )
        if _is_even(observation.times, EVEN_WITHIN_DAYS) and _is_even(observation.freqs, EVEN_WITHIN_HZ):
            cal.write_calfits(str(folder / "gains.calfits"), run_check=False, clobber=True)
        else:
            cal.write_calh5(str(folder / "gains.calh5"), run_check=False, clobber=True)


def _is_even(values: FloatArray, tolerance: float) -> bool:
    """Whether values are where the first and the step to the second put them, (N,)."""
    steps = np.arange(len(values)) * (values[1] - values[0] if len(values) > 1 else 0.0)
    return bool(np.all(np.abs(values - values[0] - steps) <= tolerance))
