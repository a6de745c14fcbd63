"""Rows whose antennas or sources are not where they should be, as other effects see them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock


def with_displacing(block: RowBlock, effects: Iterable[tuple[Effect, FloatArray]]) -> RowBlock:
    """Return a block that knows where its antennas and its sources are, if effects with their parameters move them."""
    at = [(effect, x) for effect, x in effects if x.any()]
    shifts = [effect.displacements(block.setup, x) for effect, x in at if effect.moves_antennas]
    turning = tuple((effect, x) for effect, x in at if effect.displaces_sky)
    if not shifts and not turning:
        return block
    return replace(block, moved=sum(shifts[1:], start=shifts[0]) if shifts else None, displacing=turning)
