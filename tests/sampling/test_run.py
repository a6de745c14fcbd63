"""Chains on any number of ranks, killed at any moment, and gone on with."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.sampling.begin import begin
from hydrabeam_mpi.sampling.run import groups_of_chains, run_chains
from hydrabeam_mpi.sampling.storage import writer
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.variables import variables_of
from hydrabeam_mpi.sampling.walk import Walk
from tests.loop.mock import context_of
from tests.sampling.small import COUPLING, FLUX, GAINS, small_job

NAMES = ("heldout_rms", "heldout_chi2", "heldout_log_density")
SEED = 7
KILLS = 20


def fresh(walk: Walk) -> Walk:
    """Return the walk as a new process has it: nothing has been worked out."""
    return replace(walk, **{name: type(getattr(walk, name))() for name in ("_sums", "_given", "_misfits")})


def all_draws(store: ChainStore) -> dict[str, np.ndarray]:
    chains = range(store.chains)
    return {one.name: np.array([store.read(one.name, c, slice(None)) for c in chains]) for one in store.variables}


def check_same(one: ChainStore, two: ChainStore) -> None:
    """Make sure that two folders have the same draws, to 1e-9 of what these scatter by."""
    ours, theirs = all_draws(one), all_draws(two)
    for name in (*NAMES, "log_likelihood"):
        told = [[store.info(name, chain, slice(None)) for chain in range(store.chains)] for store in (one, two)]
        np.testing.assert_allclose(*told, rtol=1e-9)
    for name, values in ours.items():
        assert values.shape[:2] == (one.chains, one.total)
        scatter = values.std(axis=(0, 1))
        np.testing.assert_array_less(np.abs(theirs[name] - values).max(axis=(0, 1)), 1e-9 * scatter + 1e-300)


def test_a_chain_killed_at_any_moment_goes_on_as_if_nothing_had_been(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With kill -9, at twenty moments or more of its warm-up and afterwards."""
    # Each draw is written at once, so that every kill has something to break.
    monkeypatch.setattr(writer, "FLUSH_S", 0.0)
    monkeypatch.setattr(writer, "PAUSE", 0.0)
    job = small_job(GAINS, COUPLING, blocks=("noise",), warm_up=20, thin=2)
    walk = begin(context_of(job, tmp_path / "data"))
    variables, folders = variables_of(walk), (tmp_path / "whole", tmp_path / "killed")
    stores = [ChainStore.create(folder, {"job": 1}, variables, 2, 30, 20) for folder in folders]
    began = time.monotonic()
    run_chains(fresh(walk), stores[0], [0, 1], SEED, 2)
    seconds = time.monotonic() - began
    rng, kills, left = generator(3, "moments"), 0, 2 * stores[1].total
    while left:
        child = os.fork()
        if not child:
            run_chains(fresh(walk), ChainStore.open(tmp_path / "killed"), [0, 1], SEED, 2)
            os._exit(0)
        # Twenty kills are to be over before the chains are.
        time.sleep(rng.uniform(0, 1.2 * seconds / KILLS) if kills < KILLS else 0.0)
        if kills < KILLS:
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        kills += os.WIFSIGNALED(status)
        before, left = left, 2 * stores[1].total - sum(map(stores[1].n_draws, (0, 1)))
        assert left <= before
    assert kills >= KILLS
    check_same(*stores)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "more",
    [{"positive_beam": "15 deg"}, {"noise_groups": "antenna", "noise_dof": 4.0}],
    ids=["beam nowhere negative", "noise of antennas"],
)
def test_any_number_of_ranks_walks_the_same_way(more: dict[str, Any], comm: MPI.Comm, common_tmp_path: Path) -> None:
    """Two channels, what they share, and two chains, begun by all ranks and gone on with by one."""
    job = small_job(GAINS, FLUX, blocks=("noise", "prior_width"), n_freqs=2, warm_up=5, **more)
    own = common_tmp_path / f"own{comm.rank}"
    alone = begin(context_of(job, own))
    group, chains = groups_of_chains(comm, 2)
    many = begin(context_of(job, common_tmp_path / f"of chain {chains[0]}", group))
    folder = common_tmp_path / "chains"
    if comm.rank == 0:
        ChainStore.create(folder, {"job": 1}, variables_of(alone), 2, 4, 5)
    comm.Barrier()
    run_chains(many, ChainStore.open(folder), chains, SEED, 1)
    comm.Barrier()
    if comm.rank == 0:
        store, other = ChainStore.open(folder), ChainStore.create(own / "a", {}, variables_of(alone), 2, 7, 5)
        store.extend(2, 7)
        run_chains(alone, store, [0, 1], SEED, 1)
        run_chains(fresh(alone), other, [0, 1], SEED, 1)
        check_same(other, store)
    comm.Barrier()


def test_a_beam_of_two_different_feeds_has_no_sign(tmp_path: Path) -> None:
    job = small_job(positive_beam="15 deg")
    job["data"]["polarization"] = "en"
    job["basis"]["form"] = "complex"
    with pytest.raises(InputError, match="has no sign"):
        begin(context_of(job, tmp_path))


def test_widths_of_a_prior_without_any_are_refused(tmp_path: Path) -> None:
    job = small_job(blocks=("prior_width",))
    job["prior"] = {"kind": "flat"}
    with pytest.raises(InputError, match="independent coefficients"):
        begin(context_of(job, tmp_path))
