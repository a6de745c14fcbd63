"""What visibilities lose as they are means: over an integration, in which the sky turns, and over a channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, EARTH_RATE, FloatArray, Observation
from hydrabeam_mpi.errors import InputError

ALIKE = 0.01
"""Relative, within which integrations or channels are equally long: what is lost, twice that, is small itself."""


@dataclass(frozen=True)
class Smearing:
    """Means over time and frequency of the fringes, of which the middle is what an instant and a frequency have.

    While a fringe turns by x, in turns, evenly, its mean is sin(pi x) / (pi x) times what it is in the middle. That the
    rate changes within an integration of T is left out: a phase of up to 0.04 (Omega T)^2 of the baseline in turns.

    Attributes
    ----------
    turn : tuple of float
        Rotation vector of the sky in an integration, ENU, radians.
    bandwidth : float
        Hz.
    """

    turn: tuple[float, float, float]
    bandwidth: float

    def left(self, vectors: FloatArray, directions: FloatArray, freq: float) -> FloatArray:
        """Return the factor that is left of every fringe, (Nvectors, Nsrc).

        Parameters
        ----------
        vectors : ndarray, (Nvectors, 3)
            Metres ENU.
        directions : ndarray, (3, Nsrc)
            Unit vectors towards the sources, ENU.
        freq : float
            Hz.
        """
        # A source at s moves by r x s in an integration, and b.(r x s) = (b x r).s
        in_time = (freq / C_M_PER_S * np.cross(vectors, self.turn)) @ directions
        in_channel = (self.bandwidth / C_M_PER_S * vectors) @ directions
        return np.asarray(np.sinc(in_time) * np.sinc(in_channel))


def mean_steps(vectors: FloatArray, turns_per_metre: float) -> list[tuple[float, float]]:
    """Return steps from the middle of a mean, in lengths of it, with their weights: of Gauss and Legendre.

    With three and two more for every turn of the fastest fringe the mean is right to 2e-5 of what has turned.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Metres ENU.
    turns_per_metre : float
        By how much the fringe of the fastest source turns in a mean, a metre of baseline.
    """
    longest = float(np.linalg.norm(vectors, axis=1).max(initial=0.0))
    nodes, weights = np.polynomial.legendre.leggauss(3 + int(np.ceil(2 * longest * turns_per_metre)))
    return list(zip((0.5 * nodes).tolist(), (0.5 * weights).tolist(), strict=True))


def smearing_of(observation: Observation) -> Smearing | None:
    """Return over what the visibilities of an observation are means; None where they are taken as of one instant.

    Raises
    ------
    InputError
        If its integrations, or its channels, differ in length, or its files were phased.
    """
    if not observation.is_smeared:
        return None
    if observation.is_phased:
        raise InputError(
            "is of means of a drift scan, and the files are phased: what follows a place on the sky while it is "
            "averaged loses by the distance from there",
            field="[data] smearing",
            remedy="leave it out, or undo with UVData.unproject_phase() what was phased after it had been averaged",
        )
    lengths = {"integrations": observation.integration_time, "channels": observation.channel_width}
    for name, of_each in lengths.items():
        if np.ptp(of_each) > ALIKE * of_each.max():
            raise InputError(
                f"{name} differ in length, from {of_each.min():.6g} to {of_each.max():.6g}",
                field="[data] smearing",
                remedy="select such as are alike, or leave it out",
            )
    latitude = observation.latitude
    pole = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    east, north, up = (-EARTH_RATE * float(observation.integration_time.mean()) * pole).tolist()
    return Smearing((east, north, up), float(observation.channel_width.mean()))
