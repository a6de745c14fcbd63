"""Rows whose antennas are not where they should be, as other effects see them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock


def with_moved_antennas(block: RowBlock, effects: Iterable[tuple[Effect, FloatArray]]) -> RowBlock:
    """Return a block that knows where its antennas are, if effects with their parameters move them."""
    shifts = [effect.displacements(block.setup, x) for effect, x in effects if effect.moves_antennas and x.any()]
    return replace(block, moved=sum(shifts[1:], start=shifts[0])) if shifts else block
