"""Along which position angle a linear feed receives at a source.

psi counts from North through East, as the IAU has it. Of an element that is fixed to the ground it is that of the
feed's own direction, East or North, projected onto the sky at the source, as of a short dipole. On an alt-az mount,
which points to the source, feeds are horizontal or vertical there, and psi follows the parallactic angle.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup

FEEDS = {"e": (1.0, 0.0, 0.0), "x": (1.0, 0.0, 0.0), "n": (0.0, 1.0, 0.0), "y": (0.0, 1.0, 0.0)}
"""Directions of feeds, East, North and Up, by their names; x is taken for East where nothing says so."""
UP = np.array([0.0, 0.0, 1.0])
Mount = Literal["fixed", "alt-az"]
"""What elements stand on, as pyuvdata calls it."""


def twice_angle(setup: ObservingSetup, directions: FloatArray, mount: Mount = "fixed") -> ComplexArray:
    """Return exp(2 i psi) of the feed at some directions, (3, N) ENU; (N,).

    The pole is that of date, which is within a few arcmin of that of the catalogue.
    """
    latitude, feed = setup.observation.latitude, np.array(FEEDS[setup.observation.pols[0][0]])
    pole, along = np.array([0.0, np.cos(latitude), np.sin(latitude)]), feed if mount == "fixed" else UP
    east = along @ np.cross(pole, directions.T).T
    north = along @ pole - (pole @ directions) * (along @ directions)
    turned = (north + 1j * east) ** 2
    # What points East on the ground is horizontal on the mount.
    sign = -1.0 if mount == "alt-az" and feed[0] else 1.0
    return np.asarray(sign * turned / np.maximum(np.abs(turned), 1e-300))
