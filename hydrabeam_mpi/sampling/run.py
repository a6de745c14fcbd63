"""Chains of a rank group: from where they are to where they shall be, a draw after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.sampling.begin import first_state
from hydrabeam_mpi.sampling.predictive import check_heldout
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.writer import ChainWriter
from hydrabeam_mpi.sampling.sweep import sweep
from hydrabeam_mpi.sampling.variables import arrays_of, state_from
from hydrabeam_mpi.sampling.walk import Walk
from hydrabeam_mpi.terminal.progress import say_meanwhile

IN_A_ROW = 20
"""Draws of one chain before the next one has its turn: with fewer of them what chains do not share is worked out anew
more often, with more of them it is longer until they can be compared."""


def groups_of_chains(world: Comm, n_chains: int) -> tuple[Comm, list[int]]:
    """Split the ranks into as many groups as there are chains, or as ranks; return this rank's group and its chains.

    Groups are runs of neighbouring ranks. Collective: all ranks of `world`.
    """
    n_groups = min(world.size, n_chains)
    mine = next(g for g in range(n_groups) if world.rank < (g + 1) * world.size // n_groups)
    chains = list(range(mine * n_chains // n_groups, (mine + 1) * n_chains // n_groups))
    return world.Split(mine, world.rank), chains


def run_chains(
    walk: Walk,
    store: ChainStore,
    chains: Sequence[int],
    seed: int,
    thin: int,
    listen: Callable[[], None] = lambda: None,
) -> None:
    """Go on with some chains of a folder until all their draws are there. Collective: the chains' ranks.

    Parameters
    ----------
    walk : Walk
    store : ChainStore
        On all ranks; only rank 0 of the chains' ranks writes.
    chains : sequence of int
    seed : int
    thin : int
        Sweeps for each draw.
    listen : callable
        Raises if the chains of other ranks have failed; called on rank 0 before each draw.

    Raises
    ------
    InputError
        On all ranks, if a chain cannot be written, or its numbers are not finite.
    """
    grid = walk.context.grid
    with ExitStack() as stack:
        writers: dict[int, ChainWriter] = {}
        with together(grid.world):
            if grid.is_world_root:
                writers = {chain: stack.enter_context(store.writer(chain)) for chain in chains}
        places: dict[int, tuple[int, ChainState]] = {chain: _resumed(walk, store, chain, seed) for chain in chains}
        while unfinished := [chain for chain in chains if places[chain][0] < store.total]:
            for chain in unfinished:
                number, state = places[chain]
                until = min(number + IN_A_ROW, store.total)
                for draw in range(number, until):
                    with together(grid.world):
                        if grid.is_world_root:
                            listen()
                    say_meanwhile(
                        f"chain {chain}: draw {draw + 1} of {store.total}", grid.is_world_root and 0 in chains
                    )
                    state = _draw(walk, state, store, writers.get(chain), Chance(seed, chain, draw), thin)
                places[chain] = until, state


def _resumed(walk: Walk, store: ChainStore, chain: int, seed: int) -> tuple[int, ChainState]:
    """Return how many draws a chain has, and its state after them. Collective: the chains' ranks."""
    grid, found = walk.context.grid, None
    with together(grid.world):
        if grid.is_world_root:
            found = store.last(chain)
    n_draws = int(grid.world.bcast(found[0] if found else 0))
    if not n_draws:
        return 0, first_state(walk, seed, chain)
    return n_draws, state_from(walk, found[1] if found else None)


def _draw(
    walk: Walk, state: ChainState, store: ChainStore, writer: ChainWriter | None, chance: Chance, thin: int
) -> ChainState:
    """Sweep for one draw, and write it; ``chance`` counts draws. Collective: the chains' ranks."""
    began, warming_up = time.perf_counter(), chance.sweep < store.warm_up
    told: list[dict[str, float]] = []
    for count in range(thin):
        of_sweep = Chance(chance.seed, chance.chain, chance.sweep * thin + count, warming_up)
        state, accepted = sweep(walk, state, of_sweep)
        told.append(accepted)
    info = {f"accepted_{name}": sum(one[name] for one in told) / thin for name in told[0]}
    info["log_likelihood"] = walk.log_likelihood(state)
    if walk.context.problem.job.sample.heldout:
        info |= check_heldout(walk, state)
    arrays = arrays_of(walk, state)
    with together(walk.context.grid.world):
        if writer is not None:
            info["seconds"] = time.perf_counter() - began
            draw = {variable.name: arrays[variable.name] for variable in store.variables}
            writer.append(draw, arrays, info)
    return state
