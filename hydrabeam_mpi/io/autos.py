"""The power that antennas measure in the course of a night, from autocorrelations."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, Observation
from hydrabeam_mpi.io.uvdata import read_autos
from hydrabeam_mpi.io.uvsource import Data

TIMES_AT_ONCE = 16
"""Whose autocorrelations are held together."""
LEAST_CHANGE = 1e-6
"""Relative, over the times: what changes by less was not measured."""


def median_power(files: Sequence[Data], observation: Observation) -> FloatArray | None:
    """Return the median autocorrelation over antennas and feeds at each time, (Nfreqs, Ntimes).

    Times without any have what lies between those before and after. None where files have them at fewer than half of
    the times of a channel, or where they do not change.

    Parameters
    ----------
    files : sequence of path or Source
    observation : Observation
    """
    power = np.full((observation.Nfreqs, observation.Ntimes), np.nan)
    for some in np.array_split(np.arange(observation.Ntimes), -(-observation.Ntimes // TIMES_AT_ONCE)):
        autos = read_autos(files, observation, some)
        known = np.where(autos.flags, np.nan, autos.power)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of times with none
            power[:, some] = np.nanmedian(known, axis=(2, 3))
    numbers = np.arange(observation.Ntimes)
    for of_channel in power:
        known = np.isfinite(of_channel) & (of_channel > 0)
        if 2 * np.count_nonzero(known) < observation.Ntimes:
            return None
        of_channel[~known] = np.interp(numbers[~known], numbers[known], of_channel[known])
        if np.ptp(of_channel) < LEAST_CHANGE * of_channel.mean():
            return None
    return power
