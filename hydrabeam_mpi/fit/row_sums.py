"""The rows of a block and the columns of beam and effects, as the normal equations take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.effects.interface.effect import Columns as EffectColumns
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.model.bases.base import LinearBasis


def row_set(block: RowBlock) -> RowSet:
    """Return the residuals of a block as rows."""
    weights = block.weights.reshape(-1)
    n_groups = len(block.groups)
    member = (np.arange(len(block.times))[:, np.newaxis] * n_groups + block.member).reshape(-1)
    return RowSet(weights * block.residual.reshape(-1), weights, member, len(block.times) * n_groups)


def beam_columns(rows: RowSet, design: NDArray[Any]) -> Columns:
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


def active_names(values: Values) -> list[str]:
    """Return the names of the blocks of the effects that are part of the model."""
    return [f"{number} {one.kind}" for number, one in enumerate(values.active)]


def active_columns(rows: RowSet, block: RowBlock, values: Values) -> dict[str, Columns]:
    """Return the columns of the effects that are part of the model, those in use."""
    made = [effect_columns(rows, one.effect.columns(block, one.x[block.channel]), one.used) for one in values.active]
    return dict(zip(active_names(values), made, strict=True))


def effect_equations(basis: LinearBasis, values: Values, candidates: Sequence[Block] = ()) -> NormalEquations:
    """Return empty sums for the effects of the model, and for candidates that are weighed one by one.

    They hold the products of the beam with all of them, but not with itself: the beam's posterior is known.
    """
    active = [Block(name, len(one.used)) for name, one in zip(active_names(values), values.active, strict=True)]
    names = [one.name for one in active]
    pairs = [(one, two) for i, one in enumerate(names) for two in names[i:]]
    pairs += [(one, two.name) for two in candidates for one in (*names, two.name)]
    pairs += [(BEAM, one.name) for one in (*active, *candidates)]
    return NormalEquations([Block(BEAM, basis.n_modes, basis.is_complex), *active, *candidates], pairs)
