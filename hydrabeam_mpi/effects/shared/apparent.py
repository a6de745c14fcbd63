"""How bright the catalogue's sources are as the array sees them: of which of them data can tell anything."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.shared.point_sources import sampled
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.positions import RotatedPositions

TURN = np.deg2rad(1.0)
"""Of times between which the sky turns by less one stands for all: a main lobe is several times as wide."""


def faintest_first(setup: ObservingSetup) -> IntArray:
    """Return all sources, ascending in the mean square over time of their flux times the model beam, (Nsrc,).

    By the middle channel's beam and the flux that channels have on average, at places of date and at all times that
    were observed, whichever are in use: so it is the same for all that look at the same sky. Sources that are never up
    come first, ascending in flux.
    """
    key = ("faintest first",)
    if key not in setup.kept:
        setup.kept[key] = _faintest_first(setup)
    order: IntArray = setup.kept[key]
    return order


def _faintest_first(setup: ObservingSetup) -> IntArray:
    sky, observation = setup.sky, setup.observation
    middle = setup.prior_mean[len(setup.prior_mean) // 2]
    beam = sampled(lambda za, az: setup.basis.synthesize(middle, za, az))
    _, times, n_alike = np.unique(np.floor(observation.lsts / TURN), return_index=True, return_counts=True)
    positions, flux, seen = RotatedPositions(sky, observation), np.abs(sky.flux.mean(axis=0)), np.zeros(sky.Nsrc)
    for itime, n in zip(times.tolist(), n_alike.tolist(), strict=True):
        index, za, az = positions.above_horizon(itime)
        seen[index] += n * (flux[index] * beam(enu(za, az))) ** 2
    return np.lexsort((flux, seen))
