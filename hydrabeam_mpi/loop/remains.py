"""What is left in the held-out data after a fit: statistics, where it lives, and whether it is more than noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hydrabeam_mpi.loop.cube import Layout, Residuals, whole_baselines
from hydrabeam_mpi.loop.heldout import Whitened
from hydrabeam_mpi.loop.refit import Space
from hydrabeam_mpi.loop.residuals import ResidualSums
from hydrabeam_mpi.loop.statistics import statistics
from hydrabeam_mpi.loop.structures import structures
from hydrabeam_mpi.loop.where import where
from hydrabeam_mpi.loop.whiteness import is_white

MIN_P = 1e-3
"""Look-corrected probability below which something is left."""


@dataclass(frozen=True)
class Remains:
    """What is left.

    Attributes
    ----------
    consistent : bool
        Whether it may be noise alone.
    white : bool
        Whether it may be noise alone at another level than the data's weights say.
    why : str
        If not, why not.
    statistics, where, structures : dict
        See the modules of these names.
    """

    consistent: bool
    white: bool
    why: str
    statistics: dict[str, Any]
    where: dict[str, Any]
    structures: dict[str, Any] | None


def remains_of(space: Space, whitened: Whitened) -> Remains:
    """Describe the held-out residuals. Collective: all ranks of the grid."""
    world, experiment, tile = space.grid.world, space.experiment, space.test.rows.tile
    layout = Layout(experiment.observation, experiment.redundant, space.problem.test.times)
    residuals = Residuals(whitened.z, whitened.used, space.problem.channel_numbers, tile.times, tile.bls)
    cube = whole_baselines(world, residuals, layout)
    sums = ResidualSums.of(cube).reduce(world)
    told = statistics(sums, layout, whitened.n_shared)
    white, why = is_white(sums, layout, whitened.n_shared)
    return Remains(
        consistent=told["significance"]["p"] >= MIN_P,
        white=white,
        why=why,
        statistics=told,
        where=where(sums, layout, whitened.n_shared),
        structures=structures(world, cube),
    )
