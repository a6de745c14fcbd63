"""What effects see: some rows of one channel with the current model of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.sky_block import SkyBlock


@dataclass(frozen=True, eq=False, kw_only=True)
class RowBlock(SkyBlock):
    """Some rows of one channel: a rank's baselines at some times, with the sky that their groups see.

    Attributes
    ----------
    bls : ndarray of int, (Nbls,)
        Indices into the observation's baselines, which belong to ``groups``.
    member : ndarray of int, (Nbls,)
        Position in ``groups`` of each baseline's group.
    weights : ndarray, (Ntimes, Nbls)
        Inverse noise variance of the calibrated data, Jy^-2; zero where there are none.
    residual : ndarray of complex, (Ntimes, Nbls)
        Calibrated data minus A b, Jy, in the sense of the groups.
    vis : ndarray of complex, (Ntimes, Nbls)
        The model A b + E of each baseline, Jy.
    design : ndarray
        Design rows of the groups, (Ntimes, 2, Ngroups, n) or complex (Ntimes, Ngroups, n).
    """

    bls: IntArray
    member: IntArray
    weights: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    residual: ComplexArray = field(default_factory=lambda: np.zeros((0, 0), dtype=complex))
    vis: ComplexArray = field(default_factory=lambda: np.zeros((0, 0), dtype=complex))
    design: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @property
    def shape(self) -> tuple[int, int]:
        """(Ntimes, Nbls)."""
        return len(self.times), len(self.bls)

    @property
    def ant1(self) -> IntArray:
        """Index of each baseline's first antenna in the sense of its group, (Nbls,)."""
        return self.setup.antenna_index[self.bls, 0]

    @property
    def ant2(self) -> IntArray:
        """Index of each baseline's second antenna in the sense of its group, (Nbls,)."""
        return self.setup.antenna_index[self.bls, 1]

    @property
    def places_in_time(self) -> IntArray:
        """Position of each of the block's times among those in use, (Ntimes,)."""
        order = np.argsort(self.setup.times)
        return order[np.searchsorted(self.setup.times, self.times, sorter=order)]

    def at_time(self, t: int) -> RowBlock:
        """Return the rows of one of the block's times."""
        now = slice(t, t + 1)
        rows = {name: getattr(self, name)[now] for name in ("times", "weights", "residual", "vis", "design")}
        return replace(self, **rows, integrals={kind: values[now] for kind, values in self.integrals.items()})

    def spread(self, by_group: Array) -> Array:
        """Give every baseline what its group has: (Ntimes, Ngroups, ...) to (Ntimes, Nbls, ...)."""
        return by_group[:, self.member]

    def summed(self, by_bl: Array) -> Array:
        """Add up what the baselines of each group have: (Ntimes, Nbls) to (Ntimes, Ngroups)."""
        n_bls = len(self.bls)
        members = csr_array((np.ones(n_bls), (self.member, np.arange(n_bls))), (len(self.groups), n_bls))
        return np.asarray((members @ by_bl.T).T)
