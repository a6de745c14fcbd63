"""First-order mutual coupling: each antenna also hears what its neighbours scatter."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from hydrabeam_mpi.data.observation import C_M_PER_S, FloatArray, IntArray
from hydrabeam_mpi.data.redundancy import RedundantGroups, find_redundant_groups
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.beam_visibilities import beam_visibilities
from hydrabeam_mpi.effects.shared.per_antenna import row_antennas
from hydrabeam_mpi.effects.shared.settings import Count

SHELL_WIDTH = 0.02
"""Distances up to this fraction above the shortest of a shell belong to it."""


class MutualCoupling(Effect):
    """A complex coupling of each of the shortest distances between antennas and of each channel.

    Voltages v_i become v_i + sum_k X_ik v_k, to first order in X (Josaitis et al. 2022), so that

        E_ij = sum_k (X_ik V_kj + X_jk* V_ik).

    The sums run over all antennas that have a baseline. They include k = j in the one and k = i in the other term, by
    which autocorrelations couple in, the largest of all. Pairs of one distance, a shell, share a coupling x, and

        X_ik = x exp(2 pi i nu |b_ik| / c)

    has the phase of the way from k to i through free space, by which what is scattered comes late. The visibilities
    that couple are those of the sky model seen by the current beam, whether or not the data have them; all that the
    block's baselines need are integrated over the sky once a block.

    An antenna amidst a regular array sees the same neighbours as the next one, and coupling is then part of its beam;
    only the antennas at the edges tell the two apart.

    Parameters
    ----------
    n_shells : int
        Number of shells.
    """

    kind = "mutual_coupling"
    title = "mutual coupling"

    def __init__(self, n_shells: Count = 12) -> None:
        self.n_shells = n_shells

    def describe(self) -> dict[str, Any]:
        """Return the number of shells."""
        return {"n_shells": self.n_shells}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for equal feeds."""
        if not setup.observation.is_copolar:
            return "visibilities couple into those of equal feeds, such as 'ee'; these are not"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return real and imaginary part of every shell's coupling."""
        shells = find_shells(_positions(setup), self.n_shells)
        lengths = [float(distances.min()) for _, _, distances in shells]
        names = [f"coupling at {length:.1f} m {part}" for length in lengths for part in ("real", "imaginary")]
        return Parameters.of(names, "", 1e-3, np.repeat(np.arange(len(shells)), 2))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return X V + V X^H of every shell for x = 1 and x = i; time by time, for one matrix V at a time.

        ``x`` is (n_params,).
        """
        setup = block.setup
        positions = _positions(setup)
        n = len(positions)
        wavenumber = 2 * np.pi * block.freq / C_M_PER_S
        shells = [
            csr_array((np.exp(1j * wavenumber * distances), (one, two)), (n, n))
            for one, two, distances in find_shells(positions, self.n_shells)
        ]
        first, second = row_antennas(block).T
        one, two = _coupling_pairs(shells, first, second, n)
        groups = _groups_of(positions[two] - positions[one], setup)
        unique = beam_visibilities(block, groups.vectors)

        values = np.empty((*block.shape, 2 * len(shells)), dtype=complex)
        matrix = np.zeros((n, n), dtype=complex)
        for t, row in enumerate(unique):
            pairs = np.where(groups.flipped, row[groups.group].conj(), row[groups.group])
            matrix[one, two], matrix[two, one] = pairs, pairs.conj()
            for shell, coupling in enumerate(shells):
                product = coupling @ matrix
                # V is Hermitian, and V X^H therefore the adjoint of X V.
                there, back = product[first, second], product[second, first].conj()
                values[t, :, 2 * shell] = there + back
                values[t, :, 2 * shell + 1] = 1j * (there - back)
        return Columns(values, values.shape[-1])


def find_shells(positions: FloatArray, n_shells: int) -> list[tuple[IntArray, IntArray, FloatArray]]:
    """Find the pairs of the shortest distances among ``positions``, (N, 3).

    Returns
    -------
    list of tuple
        Each shell's pairs in both orders, as two arrays of indices, and their distances in metres.
    """
    distances = np.linalg.norm(positions[:, np.newaxis] - positions, axis=-1)
    shells = []
    beyond = 0.0
    for _ in range(n_shells):
        left = distances[distances > beyond]
        if not len(left):
            break
        shortest, beyond = left.min(), left.min() * (1 + SHELL_WIDTH)
        one, two = np.nonzero((distances >= shortest) & (distances <= beyond))
        shells.append((one, two, distances[one, two]))
    return shells


def _positions(setup: ObservingSetup) -> FloatArray:
    """Return the positions of the antennas in use, (N, 3)."""
    return setup.observation.antpos[setup.antennas_in_use]


def _coupling_pairs(shells: list[Any], first: IntArray, second: IntArray, n: int) -> tuple[IntArray, IntArray]:
    """Return the pairs whose visibilities couple into those of given pairs: i <= j, indices of antennas in use."""
    ends = np.concatenate([first, second]), np.concatenate([second, first])
    into = csr_array((np.ones(len(ends[0])), ends), (n, n))
    neighbours = sum((abs(coupling) for coupling in shells), csr_array((n, n)))
    coupled = (neighbours @ into).tocoo()
    lower, upper = np.sort(np.stack([coupled.row, coupled.col]).astype(np.int64), axis=0)
    one, two = np.divmod(np.unique(lower * n + upper), n)
    return one, two


def _groups_of(vectors: FloatArray, setup: ObservingSetup) -> RedundantGroups:
    """Group vectors with the baselines of the data where they agree with some as these do among themselves.

    Vectors without a baseline in the data, that of autocorrelations first of all, are grouped among themselves.
    """
    known = setup.redundant
    spread = setup.observation.bl_vectors * np.where(known.flipped, -1, 1)[:, np.newaxis]
    tol = np.linalg.norm(spread - known.vectors[known.group], axis=1).max() + 1e-6
    distance, place = cKDTree(np.concatenate([known.vectors, -known.vectors])).query(vectors)
    flipped, group = np.divmod(place, known.Ngroups)
    flipped = flipped.astype(bool)
    every = known.vectors
    lacking = distance > tol
    if lacking.any():
        further = find_redundant_groups(vectors[lacking], tol)
        group[lacking], flipped[lacking] = known.Ngroups + further.group, further.flipped
        every = np.concatenate([every, further.vectors])
    used, group = np.unique(group, return_inverse=True)
    return RedundantGroups(every[used], group, flipped)
