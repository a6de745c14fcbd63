"""Grating lobes: directions in which an array on a lattice sees a source alike.

With generators a_1 and a_2 of the lattice, fringes are the same at direction cosines s and s + d where a_i.d is a whole
number of wavelengths. As the sky turns the two part, unless what is seen in one of them moves against the stars.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.model.engines.fringes import enu, find_lattice
from hydrabeam_mpi.model.sky import Sky

ALIKE = 0.05
"""Wavelengths by which baselines may be off the lattice: then fringes agree to a third of a radian."""
POINTS = np.array([one for one in product((-1.0, 0.0, 1.0), repeat=3) if any(one)])
"""Directions all over the sky, nine of which at least are above any horizon, by which it is told how the sky turns."""


def grating_lobes(setup: ObservingSetup) -> FloatArray:
    """Return the shifts d, in direction cosines East and North, of all lobes that may be above the horizon together.

    They are (n_lobes, 2); none off a lattice.
    """
    wavelength = C_M_PER_S / setup.reference_freq
    lattice = find_lattice(setup.redundant.vectors, ALIKE * wavelength)
    if lattice is None:
        return np.zeros((0, 2))
    generators = lattice.generators[:, :2] / wavelength
    # |d| < 2 between two horizons.
    most = np.floor(2 * np.linalg.norm(generators, axis=1)).astype(int)
    turns = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in most)), axis=-1).reshape(-1, 2)
    lobes = turns[np.any(turns != 0, axis=1)] @ np.linalg.inv(generators).T
    return np.asarray(lobes[np.hypot(*lobes.T) < 2])


def turns_of_sky(setup: ObservingSetup, itimes: IntArray) -> list[FloatArray]:
    """Return the rotations from the sources' frame to East, North and Up at times of the observation, (3, 3) each.

    What aberration adds to them is 20 arcsec.
    """
    points = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    ra, dec = np.arctan2(points[:, 1], points[:, 0]), np.arcsin(points[:, 2])
    positions = setup.positions(Sky(ra, dec, np.ones((1, len(ra)))), setup.observation)
    rotations = []
    for itime in itimes.tolist():
        index, za, az = positions.above_horizon(itime)
        left, _, right = np.linalg.svd(enu(za, az) @ points[index])
        rotations.append(left @ right)
    return rotations


def seen_alike(turn: FloatArray, at: FloatArray, lobes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where on the sky a source's lobes are, and their zenith angles.

    Parameters
    ----------
    turn : ndarray, (3, 3)
        Of the sky at that time, of `turns_of_sky`.
    at : ndarray, (2,)
        Right ascension and declination of the source, radians.
    lobes : ndarray, (n_lobes, 2)
        Of `grating_lobes`.

    Returns
    -------
    places : ndarray, (n_lobes, 2)
        Right ascensions and declinations; NaN where a lobe, or the source itself, is not above the horizon.
    za : ndarray, (n_lobes,)
    """
    ra, dec = at
    east, north, up = turn @ [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    wanted = np.array([east, north]) + lobes
    cosine = 1 - np.sum(wanted**2, axis=1)
    height = np.sqrt(np.where((cosine > 0) & (up > 0), cosine, np.nan))
    x, y, z = turn.T @ np.vstack([wanted.T, height])
    return np.stack([np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1))], axis=1), np.arccos(height)
