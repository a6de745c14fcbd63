"""What effects add goes with the beam: it is in proportion to it, as all visibilities of the sky are.

E of a tilted antenna, or of one that is elsewhere, is linear in the beam's coefficients b. Near b it is known without
another pass over the sky along one direction, that in which the beam becomes larger or smaller as a whole:
E(a b) = a E(b). Along others it is taken to change as the visibilities A b do, so that the columns of the beam are

    A + E w^H,   w = A^H N^-1 A b / (b^H A^H N^-1 A b).

Without that a scale that all gains have in common, which no data can tell from another beam, would seem to be told by
the visibilities of a tilted antenna.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky

from hydrabeam_mpi.data.observation import Array, ComplexArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Estimate
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import Prior

ADDED = "added"
"""Name of the block of what effects add."""


@dataclass(frozen=True)
class AddedBlock:
    """The scale of what effects add in proportion to the beam: one unknown, with E as its column.

    Attributes
    ----------
    added : ndarray of complex, (Ntimes, Nbls)
        That E, of a channel's rows.
    times : ndarray of int, (Ntimes,)
        Of these rows, ascending.
    is_complex : bool
        Whether the beam's coefficients are, by which the scale is, too.
    """

    added: ComplexArray
    times: Array
    is_complex: bool
    size: int = 1
    effects: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, share: RankData, at: Estimate, channel: int, added: ComplexArray) -> AddedBlock | None:
        """Return that of a model, of whose effects all add E, (Ntimes, Nbls); None where nothing goes with the beam."""
        adding = [one for one in at.values.active if not one.effect.multiplies and not one.effect.changes_sky]
        others = [one for one in adding if not one.effect.is_seen_by_beam]
        if len(others) == len(adding):
            return None
        if others:
            added = added - share.effects_of(at, others)[1][channel]
        return cls(added, share.rows.tile.times, at.beams[channel].is_complex)

    def columns(self, rows: RowSet, block: RowBlock) -> Columns:
        """Return E at the block's rows."""
        some = self.added[np.searchsorted(self.times, block.times)]
        return Columns(rows, some.reshape(-1, 1), by_group=False)


@dataclass(frozen=True)
class WithTheBeam:
    """What changes as the beam does, beside its own columns.

    Attributes
    ----------
    sums : NormalEquations
        With the block `ADDED`.
    weights : ndarray, (n_modes,)
        w: by how much E is larger is w^H times by how much each coefficient is.
    posterior : Posterior
        Of the beam, with E as it is.
    """

    sums: NormalEquations
    weights: Array
    posterior: Posterior

    @classmethod
    def of(cls, sums: NormalEquations, posterior: Posterior, prior: Prior) -> WithTheBeam | None:
        """Tell from sums over rows at the mean of a beam's ``posterior``; None where nothing goes with it."""
        if ADDED not in sums.blocks:
            return None
        b, factor = posterior.mean, posterior.factor
        seen = factor @ (factor.conj().T @ b) - prior.precision_times(b)
        norm = float(np.vdot(b, seen).real)
        return cls(sums, seen / norm, posterior) if norm > 0 else None

    @cached_property
    def factor(self) -> Array:
        """The factor of the beam's precision with what goes with it, (n_modes, n_modes)."""
        kappa = 1.0 if self.posterior.is_complex else 2.0
        across, own = self.sums.gather([BEAM], [ADDED]), self.sums.own(ADDED).real
        both = (across + 0.5 * self.weights[:, np.newaxis] * own) @ self.weights.conj()[np.newaxis]
        return cholesky(
            self.posterior.precision + kappa * (both + both.conj().T), lower=True, overwrite_a=True, check_finite=False
        )

    @property
    def pull(self) -> Array:
        """How the data pull on the beam by what goes with it, (n_modes,): E was taken as it is when it was fitted."""
        kappa = 1.0 if self.posterior.is_complex else 2.0
        return kappa * self.weights * self.sums.projection[ADDED]

    def across(self, names: Sequence[str]) -> Array:
        """Return w E^H N^-1 A of some blocks, (n_modes, q), which the beam's own products with them lack."""
        return self.weights[:, np.newaxis] * self.sums.gather([ADDED], names)
