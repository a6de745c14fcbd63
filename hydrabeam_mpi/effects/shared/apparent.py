"""How bright the catalogue's sources are as the array sees them: of which of them data can tell anything."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.model.positions import RotatedPositions

MOST_TIMES = 24
"""Times at which sources are looked at, spread over all: those that are up at none of them are so for minutes."""
STEP = np.deg2rad(1.0)
"""Of the grid on which the model beam is taken: what falls between two nodes is no other by a large factor."""
LEAST_POWER = 1e-12
"""Of the beam's largest: among sources that it does not see, those that are brighter in the catalogue come first."""


def apparent_power(setup: ObservingSetup) -> FloatArray:
    """Return the mean square over time of every source's flux times the model beam, Jy^2, (Nsrc,).

    Of the middle channel's beam and of the flux that channels have on average, at places of date and at all times that
    were observed, whichever are in use: so it is the same for all that look at the same sky.
    """
    key = ("apparent power",)
    if key not in setup.kept:
        setup.kept[key] = _apparent_power(setup)
    power: FloatArray = setup.kept[key]
    return power


def _apparent_power(setup: ObservingSetup) -> FloatArray:
    sky, n_times = setup.sky, setup.observation.Ntimes
    times = np.unique(np.linspace(0, n_times - 1, min(n_times, MOST_TIMES)).round().astype(int))
    power_at, positions, seen = _beam_power(setup), RotatedPositions(sky, setup.observation), np.zeros(sky.Nsrc)
    n_za, n_az = power_at.shape
    for itime in times.tolist():
        index, za, az = positions.above_horizon(itime)
        ring, ray = np.rint(za / STEP).astype(int), np.rint(az / STEP).astype(int) % n_az
        seen[index] += power_at[np.minimum(ring, n_za - 1), ray]
    seen = seen / len(times) + LEAST_POWER * float(power_at.max())
    return np.asarray(seen * sky.flux.mean(axis=0) ** 2)


def _beam_power(setup: ObservingSetup) -> FloatArray:
    """Return the square of the model beam on a grid of zenith angle and azimuth from East, (91, 360)."""
    za, az = np.meshgrid(STEP * np.arange(91), STEP * np.arange(360), indexing="ij")
    middle = setup.prior_mean[len(setup.prior_mean) // 2]
    beam = np.asarray(setup.basis.synthesize(middle, za.ravel(), az.ravel()))
    return (np.abs(beam) ** 2).reshape(za.shape)
