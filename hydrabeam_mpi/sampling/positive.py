"""Where beams may not be negative."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.nonnegative import NonNegative
from hydrabeam_mpi.setup.problem import Problem


def nowhere_negative(problem: Problem, spacing: float) -> NonNegative:
    """Return what makes the real part of a beam in a problem's basis nowhere negative at points ``spacing`` deg apart.

    Raises
    ------
    InputError
        If the beam is that of two different feeds, which has no sign.
    """
    if not problem.beams[0].info.is_copol:
        raise InputError(
            f"a beam of polarization '{problem.job.data.pol}', of two different feeds, has no sign",
            field="[sample] positive_beam",
            remedy="leave it out",
        )
    return NonNegative(np.ascontiguousarray(problem.basis.evaluate(*points(spacing)).T))


def points(spacing: float) -> tuple[FloatArray, FloatArray]:
    """Return zenith angles and azimuths, rad, (K,) each, of points on rings about the zenith to the horizon.

    Rings, and points along each, are as far apart as ``spacing``, deg, or a little less.
    """
    n_rings = int(np.ceil(90 / spacing))
    rings = np.linspace(0, np.pi / 2, n_rings + 1)
    numbers = np.ceil(np.round(4 * n_rings * np.sin(rings), 9)).clip(1).astype(int)
    az = [2 * np.pi * np.arange(number) / number for number in numbers.tolist()]
    return np.repeat(rings, numbers), np.concatenate(az)
