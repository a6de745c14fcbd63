"""Redundant baselines: identical beams make the visibilities a function of the baseline vector only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.constants import speed_of_light
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.errors import InputError


@dataclass(frozen=True)
class RedundantGroups:
    """Baselines grouped by vector.

    Attributes
    ----------
    vectors : ndarray, (Ngroups, 3)
        The common vector of each group, metres ENU: the mean of its members.
    group : ndarray of int, (Nbls,)
        The group that each baseline belongs to.
    flipped : ndarray of bool, (Nbls,)
        True where the baseline points the other way, so that its visibilities enter conjugated.
    """

    vectors: FloatArray
    group: IntArray
    flipped: BoolArray

    @property
    def Ngroups(self) -> int:
        """Number of unique baseline vectors."""
        return len(self.vectors)


def find_redundant_groups(bl_vectors: FloatArray, tol: float, either_sign: bool = True) -> RedundantGroups:
    """Group baselines whose vectors agree within ``tol``.

    Parameters
    ----------
    bl_vectors : ndarray, (Nbls, 3)
        Metres ENU.
    tol : float
        Vectors closer than this, in metres, are one; so are all that such steps connect.
    either_sign : bool
        Whether a baseline and its reverse share a group. True for co-polarised data, where V_kj = V_jk*;
        a cross-polarised visibility of the reversed baseline belongs to the other polarisation pair.

    Returns
    -------
    RedundantGroups
        In order of the first member; vectors point to the half space E > 0 (then N > 0, then U > 0) where
        either sign is allowed.
    """
    n_bls = len(bl_vectors)
    points = np.concatenate([bl_vectors, -bl_vectors]) if either_sign else bl_vectors
    pairs = cKDTree(points).query_pairs(tol, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=2 * (len(points),))
    n_sets, member_of = connected_components(links, directed=False)

    counts = np.bincount(member_of, minlength=n_sets)
    sums = np.stack([np.bincount(member_of, points[:, axis], n_sets) for axis in range(3)], axis=1)
    means = sums / counts[:, np.newaxis]
    flipped = ~_points_forward(means[member_of[:n_bls]], tol) if either_sign else np.zeros(n_bls, dtype=bool)
    chosen = np.where(flipped, member_of[np.arange(n_bls) + n_bls * flipped], member_of[:n_bls])

    sets, first, group = np.unique(chosen, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank_of = np.empty_like(order)
    rank_of[order] = np.arange(len(order))
    return RedundantGroups(means[sets[order]], rank_of[group], flipped)


def check_tolerance(observation: Observation, redundant: RedundantGroups, tol: float) -> None:
    """Make sure that redundant baselines see the same fringes.

    Raises
    ------
    InputError
        If a baseline is half a wavelength or more from what its group is taken for: their visibilities may then have
        opposite signs.
    """
    own = np.where(redundant.flipped, -1.0, 1.0)[:, np.newaxis] * observation.bl_vectors
    away = np.linalg.norm(own - redundant.vectors[redundant.group], axis=1)
    wavelength = speed_of_light / float(observation.freqs.max())
    if away.max(initial=0.0) >= wavelength / 2:
        one, two = observation.antpairs[away.argmax()]
        raise InputError(
            f"within {tol:g} m baseline {one}-{two} counts as one that differs by {away.max():.3g} m,"
            f" {away.max() / wavelength:.2g} wavelengths",
            field="[data] redundancy_tol",
            remedy="make it smaller, or set compress = false in [solver]",
        )


def check_apart(observation: Observation, tol: float) -> None:
    """Make sure that no two antennas stand in one place.

    Raises
    ------
    InputError
        If two are within ``tol`` metres.
    """
    pairs = cKDTree(observation.antpos).query_pairs(tol, output_type="ndarray")
    if len(pairs):
        one, two = observation.antenna_numbers[pairs[0]]
        raise InputError(
            f"antennas {one} and {two} stand in one place, within redundancy_tol = {tol:g} m",
            field="[data.simulate.array]",
            remedy="place them apart, or make the tolerance smaller",
        )


def _points_forward(vectors: FloatArray, tol: float) -> BoolArray:
    """Tell which vectors have their first component beyond ``tol`` positive."""
    significant = np.abs(vectors) > tol
    first = np.argmax(significant, axis=1)
    leading = np.take_along_axis(vectors, first[:, np.newaxis], axis=1)[:, 0]
    return (leading > 0) | ~significant.any(axis=1)
