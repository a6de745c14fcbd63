"""Grating lobes: directions in which an array on a lattice sees a source alike.

With generators a_1 and a_2 of the lattice, fringes are the same at direction cosines s and s + d where a_i.d is a whole
number of wavelengths. As the sky turns the two part, unless what is seen in one of them moves against the stars.
"""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.model.engines.fringes import enu, find_lattice
from hydrabeam_mpi.model.sky import Sky

ALIKE = 0.05
"""Wavelengths by which baselines may be off the lattice: then fringes agree to a third of a radian."""
MOST_STEPS = 3
"""Along either generator's lobes: more of them are not above the horizon of an array whose elements stand apart."""


def grating_lobes(setup: ObservingSetup) -> FloatArray:
    """Return the shifts d of all lobes, in direction cosines East and North, (n_lobes, 2); none off a lattice."""
    wavelength = C_M_PER_S / setup.reference_freq
    lattice = find_lattice(setup.redundant.vectors, ALIKE * wavelength)
    if lattice is None:
        return np.zeros((0, 2))
    steps = np.arange(-MOST_STEPS, MOST_STEPS + 1)
    turns = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    turns = turns[np.any(turns != 0, axis=1)]
    return np.asarray(wavelength * turns @ np.linalg.inv(lattice.generators[:, :2]).T)


def seen_alike(
    setup: ObservingSetup, itime: int, at: tuple[float, float], points: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return where on the sky a source's lobes are at a time of the observation, and their zenith angles.

    Parameters
    ----------
    setup : ObservingSetup
    itime : int
    at : (float, float)
        Right ascension and declination of the source, radians.
    points : (ndarray, ndarray)
        Those of any points all over the sky, (Npoints,) each, by which it is told how the sky is turned.

    Returns
    -------
    places : ndarray, (n_lobes, 2)
        Right ascensions and declinations; NaN where a lobe, or the source itself, is not above the horizon.
    za : ndarray, (n_lobes,)
    """
    ra, dec = (np.append(one, own) for one, own in zip(points, at, strict=True))
    positions = setup.positions(Sky(ra, dec, np.ones((1, len(ra)))), setup.observation)
    index, za, az = positions.above_horizon(itime)
    lobes = grating_lobes(setup)
    places, zenith = np.full((len(lobes), 2), np.nan), np.full(len(lobes), np.nan)
    if len(ra) - 1 not in index:
        return places, zenith
    directions = enu(za, az)
    sky = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])[:, index]
    # The rotation that leads from the sky to the array; what aberration adds to it is 20 arcsec.
    left, _, right = np.linalg.svd(directions @ sky.T)
    wanted = directions[:2, -1] + lobes
    up = np.flatnonzero(np.hypot(*wanted.T) < 1)
    height = np.sqrt(1 - np.sum(wanted[up] ** 2, axis=1))
    x, y, z = (left @ right).T @ np.vstack([wanted[up].T, height])
    places[up] = np.stack([np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1))], axis=1)
    zenith[up] = np.arccos(height)
    return places, zenith
