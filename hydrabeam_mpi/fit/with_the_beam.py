"""What effects add goes with the beam: it is in proportion to it, as all visibilities of the sky are.

E of a tilted antenna, or of one that is elsewhere, is linear in the beam. How it changes is known without another pass
over the sky where all of the beam becomes larger or smaller: E(a B) = a E(B). Else it is taken to change as the beam's
visibilities do. With m = sum_k A_k y_k what the beam sees, by its coefficients and by all else that is part of it (what
channels have in common, functions beyond the basis), the columns of each of these are

    A_k + E w_k^H,   w_k = A_k^H N^-1 m / (m^H N^-1 m).

Without that a scale that all gains have in common, which no data can tell from another beam, would seem to be told by
the visibilities of a tilted antenna.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError

from hydrabeam_mpi.data.observation import Array, ComplexArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.blocks import CandidateBlock, ColumnBlock
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.grown import is_of_the_beam
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Active, Estimate
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.inference.rank_update import with_product

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
    times: IntArray
    is_complex: bool
    size: int = 1
    effects: tuple[Effect, ...] = ()

    def columns(self, rows: RowSet, block: RowBlock) -> Columns:
        """Return E at the block's rows."""
        some = self.added[np.searchsorted(self.times, block.times)]
        return Columns(rows, some.reshape(-1, 1), by_group=False)


def with_added(
    context: FitContext,
    share: RankData,
    at: Estimate,
    channel: int,
    added: ComplexArray,
    effects: Mapping[str, ColumnBlock],
) -> dict[str, ColumnBlock]:
    """Return the blocks of the model: its beam and effects, and what these add where that goes with the beam.

    Of beams that hang together over frequency it is taken to be the same. All that effects add are ``added``, (Ntimes,
    Nbls), of one of the group's channels.
    """
    model: dict[str, ColumnBlock] = {BEAM: context.beam, **effects}
    adding = [one for one in at.values.active if not one.effect.multiplies and not one.effect.changes_sky]
    others = [one for one in adding if not one.effect.is_seen_by_beam]
    if context.problem.coupling is None and len(others) < len(adding):
        if others:
            added = added - share.effects_of(at, others, channel)[1][channel]
        model[ADDED] = AddedBlock(added, share.rows.tile.times, context.beam.is_complex)
    return model


def without_beam(
    context: FitContext,
    sums: NormalEquations,
    channel: int,
    beam: Posterior,
    prior: Prior,
    effects: Mapping[str, ColumnBlock],
    pull: Array | None = None,
) -> Marginal:
    """Return a channel's sums with its beam marginalised, and what goes with it.

    Parameters
    ----------
    context : FitContext
    sums : NormalEquations
        At the mean of the beam, of the blocks of `with_added`.
    channel : int
        Among the job's.
    beam : Posterior
        With E as it is.
    prior : Prior
        Of the beam.
    effects : mapping of str to ColumnBlock
        Of which there are sums.
    pull : ndarray, (n_modes,), optional
        As of `Marginal`.
    """
    weights = _weights(context, sums, channel, beam, prior, effects) if ADDED in sums.blocks else {}
    if not weights:
        return Marginal(sums, BEAM, beam, pull)
    kappa, own = 1.0 if beam.is_complex else 2.0, weights[BEAM]
    # E was as it is when the beam was fitted, so that its best value is another one.
    by_added = kappa * own * sums.projection[ADDED]
    across, square = sums.gather([BEAM], [ADDED]), sums.own(ADDED).real
    try:
        factor = with_product(beam.factor, kappa * (across[:, 0] + 0.5 * own * square[0, 0]), own)
    except LinAlgError:
        # Of a beam of which some combinations are hardly told rounding may leave no more than that.
        return Marginal(sums, BEAM, beam, pull)
    followed = sums.with_part(ADDED, weights)
    return Marginal(followed, BEAM, Posterior(beam.mean, factor), by_added if pull is None else pull + by_added)


def _weights(
    context: FitContext,
    sums: NormalEquations,
    channel: int,
    beam: Posterior,
    prior: Prior,
    effects: Mapping[str, ColumnBlock],
) -> dict[str, Array]:
    """Return w_k of each block that is of the beam, (size,); none where the beam sees nothing."""
    setup, kappa = context.setup, 1.0 if beam.is_complex else 2.0
    parts = {name: one for name, one in effects.items() if isinstance(one, Active | CandidateBlock)}
    parts = {name: one for name, one in parts.items() if is_of_the_beam(setup, one)}
    y: dict[str, Array] = {BEAM: beam.mean}
    for name, one in parts.items():
        y[name] = (one.x[channel] if isinstance(one, Active) else one.x)[one.used]
    # The products of the beam's columns with each other are what its precision has beyond its prior.
    told = beam.factor @ (beam.factor.conj().T @ beam.mean) - prior.precision_times(beam.mean)
    found = {BEAM: told / kappa + _times(sums, BEAM, {name: y[name] for name in parts})}
    for name, one in parts.items():
        units = np.eye(len(one.effect.parameters(setup)))[one.used]
        coefficients = one.effect.beam_coefficients(setup, units)
        found[name] = _times(sums, name, y) if coefficients is None else coefficients.conj() @ found[BEAM]
    norm = sum(float(np.vdot(y[name], found[name]).real) for name in found)
    return {name: one / norm for name, one in found.items()} if norm > 0 else {}


def _times(sums: NormalEquations, name: str, y: Mapping[str, Array]) -> Array:
    """Return A_k^H N^-1 of what some blocks see at ``y``, as far as there are sums of their products, (size,)."""
    seen = [sums.gather([name], [other]) @ x for other, x in y.items() if sums.has(name, other)]
    return np.asarray(sum(seen, start=np.zeros(sums.blocks[name].size)))
