"""The blocks of the model: the beam, each effect, and what is weighed beside them.

A block is some unknowns that the visibilities depend on. To the sums over rows (`NormalEquations`) all of them are
alike: columns at the current values. A chain adds a block by a class with the members of `ModelBlock`, for example the
fluxes of sources, with the beam integrated over each source as columns. What scales the noise has no columns; it is a
factor of the weights and is fitted from other sums (`Reweighting`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns as EffectColumns
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.inference.prior import ChannelPrior
from hydrabeam_mpi.model.bases.base import LinearBasis


class ColumnBlock(Protocol):
    """Unknowns of a channel and how its visibilities change with them."""

    @property
    def size(self) -> int:
        """Number of unknowns."""

    @property
    def is_complex(self) -> bool:
        """Whether they are complex."""

    @property
    def effects(self) -> Sequence[Effect]:
        """Effects whose integrals over the sky the columns are made of."""

    def columns(self, rows: RowSet, block: RowBlock) -> Columns:
        """Return the derivatives of the model at the current values, for ``block``, whose rows are ``rows``."""


class EffectBlock(ColumnBlock, Protocol):
    """Unknowns that are parameters of an effect."""

    @property
    def used(self) -> IntArray:
        """Which of the effect's parameters these are."""


class ModelBlock(ColumnBlock, Protocol):
    """A part of the model: unknowns with a prior."""

    @property
    def prior(self) -> ChannelPrior:
        """Over channels."""

    @property
    def held(self) -> FloatArray:
        """Combinations of the unknowns that no data decide and that are held at zero, (n, size)."""

    def labels(self, setup: ObservingSetup) -> list[tuple[str, str]]:
        """Return name and unit of each unknown, in their order."""


@dataclass(frozen=True)
class BeamBlock:
    """The beam's coefficients in a basis.

    Attributes
    ----------
    basis : LinearBasis
    prior : ChannelPrior
    """

    basis: LinearBasis
    prior: ChannelPrior
    effects: Sequence[Effect] = ()

    @property
    def size(self) -> int:
        """Number of modes."""
        return self.basis.n_modes

    @property
    def is_complex(self) -> bool:
        """Whether the coefficients are complex."""
        return self.basis.is_complex

    @property
    def held(self) -> FloatArray:
        """None, (0, n_modes): of the beam the prior decides what the data do not."""
        return np.zeros((0, self.size))

    def labels(self, setup: ObservingSetup) -> list[tuple[str, str]]:
        """Return the numbers of the coefficients, which have no unit."""
        return [(f"coefficient {number} of the beam", "") for number in range(self.size)]

    def columns(self, rows: RowSet, block: RowBlock) -> Columns:
        """Return the design rows of the block's groups."""
        return beam_columns(rows, block.design)


@dataclass(frozen=True)
class CandidateBlock:
    """Parameters of an effect that is weighed for the model, linearised at ``x``, (n_params,).

    They are all, or ``only`` some, (n,).
    """

    effect: Effect
    x: FloatArray
    is_complex: bool = False
    only: IntArray | None = None

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.used)

    @property
    def used(self) -> IntArray:
        """The numbers of these parameters."""
        return np.arange(len(self.x)) if self.only is None else self.only

    @property
    def effects(self) -> Sequence[Effect]:
        """The effect."""
        return (self.effect,)

    def columns(self, rows: RowSet, block: RowBlock) -> Columns:
        """Return the effect's columns."""
        return effect_columns(rows, block.derivative(self.effect, self.x), self.only)


def sums_of(model: Mapping[str, ColumnBlock], candidates: Mapping[str, ColumnBlock] | None = None) -> NormalEquations:
    """Return empty sums for the blocks of a model, and for candidates that are weighed one by one.

    They hold the products of the beam with all of them, but not with itself: the beam's posterior is known.
    """
    candidates, effects = candidates or {}, [name for name in model if name != BEAM]
    pairs = [(one, two) for i, one in enumerate(effects) for two in effects[i:]]
    pairs += [(one, two) for two in candidates for one in (*effects, two)]
    pairs += [(BEAM, one) for one in (*effects, *candidates)]
    blocks = [Block(name, one.size, one.is_complex) for name, one in (*model.items(), *candidates.items())]
    return NormalEquations(blocks, pairs)


def add_block(
    total: NormalEquations,
    block: RowBlock,
    model: Mapping[str, ColumnBlock],
    candidates: Mapping[str, ColumnBlock] | None = None,
) -> None:
    """Add the rows of a block to the sums of a model's blocks and of candidates, each of these by itself."""
    rows = row_set(block)
    _integrate(block, model)
    found = {name: one.columns(rows, block) for name, one in model.items()}
    total.add_rows(found)
    if candidates:
        _integrate(block, candidates)
        for name, one in candidates.items():
            total.add_rows({name: one.columns(rows, block)}, found)


def _integrate(block: RowBlock, blocks: Mapping[str, ColumnBlock]) -> None:
    """Integrate over the sky what these need, in one pass."""
    block.integrate_for([effect for one in blocks.values() for effect in one.effects])


def row_set(block: RowBlock) -> RowSet:
    """Return the residuals of a block as rows."""
    weights = block.weights.reshape(-1)
    n_groups = len(block.times) * len(block.groups)
    return RowSet(weights * block.residual.reshape(-1), weights, member_of_rows(block), n_groups)


def member_of_rows(block: RowBlock) -> IntArray:
    """Return to which of the block's times and groups, in their order, each row belongs, (Ntimes x Nbls,)."""
    return (np.arange(len(block.times))[:, np.newaxis] * len(block.groups) + block.member).reshape(-1)


def beam_columns(rows: RowSet, design: Array) -> Columns:
    """Return the beam's columns at the rows of a block.

    Parameters
    ----------
    rows : RowSet
    design : ndarray
        Design rows of the block's times and groups: (Ntimes, 2, Ngroups, n) real and imaginary parts for real
        coefficients, (Ntimes, Ngroups, n) for complex ones.
    """
    n_modes = design.shape[-1]
    is_complex = np.iscomplexobj(design)
    values = design.reshape(-1, n_modes) if is_complex else np.moveaxis(design, 1, 0).reshape(2, -1, n_modes)
    return Columns(rows, values, by_group=True)


def effect_columns(rows: RowSet, columns: EffectColumns, used: IntArray | None = None) -> Columns:
    """Return an effect's columns at the rows of a block, or only those of the parameters ``used``, (Nused,)."""
    matrix = columns.matrix()
    return Columns(rows, matrix if used is None else matrix[:, used], columns.by_group)
