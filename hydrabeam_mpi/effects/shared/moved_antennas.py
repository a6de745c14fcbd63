"""Rows whose antennas are not where they should be, as other effects see them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock


def with_moved_antennas(block: RowBlock, effects: Iterable[tuple[Effect, FloatArray]]) -> RowBlock:
    """Return a block with the true vectors of its baselines, if effects with their parameters move antennas."""
    moving = [(effect, x) for effect, x in effects if effect.moves_antennas and x.any()]
    if not moving:
        return block
    moved = block.vectors[block.member] + sum(effect.displacements(block, x) for effect, x in moving)
    return replace(block, moved=moved)
