"""Chains of draws of beam, effects and noise together: what `hydrabeam sample` and `sample` share."""

from __future__ import annotations

import json
import weakref
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pydantic import ValidationError

from hydrabeam_mpi.api.chains import Chains
from hydrabeam_mpi.api.preparation import prepare_checked
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import begun, origin_of
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.mistakes import as_input_error
from hydrabeam_mpi.config.sample import Sample
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.joint import read_context
from hydrabeam_mpi.loop.checks.health import told
from hydrabeam_mpi.mpi import Comm, ProcessGrid, apart, together
from hydrabeam_mpi.sampling.begin import begin
from hydrabeam_mpi.sampling.convergence import diagnose
from hydrabeam_mpi.sampling.run import groups_of_chains, run_chains
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.variables import variables_of
from hydrabeam_mpi.sampling.walk import Walk
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.progress import say, warn


def sample(
    setup: Setup,
    folder: str | Path | None = None,
    *,
    blocks: Sequence[str] | None = None,
    chains: int | None = None,
    draws: int | None = None,
    **more: Any,
) -> Chains:
    """Draw from the joint posterior of beam, effects, noise and the prior's width (HDBI II, appendix A).

    Collective: all ranks of the setup's communicator.

    Parameters
    ----------
    setup : Setup
    folder : str or Path, optional
        Where the draws are kept. If chains of this setup are there already, they are gone on with. A temporary one by
        default, which goes with what is returned.
    blocks : sequence of str, optional
        What is drawn: "beam" (always), "noise", "prior_width" and kinds of effects. As the setup says by default.
    chains, draws : int, optional
        How many chains, and how many draws of each after its warm-up. As the setup says by default.
    **more
        Other keys of ``[sample]``, such as ``effects``, ``warm_up`` and ``thin``.

    Returns
    -------
    Chains

    Raises
    ------
    InputError
        On all ranks, if the data or another argument cannot be used.
    """
    given = {"blocks": blocks, "chains": chains, "draws": draws, **more}
    with setup.telling():
        changed = with_sample(setup.job, {name: value for name, value in given.items() if value is not None})
    setup = Setup.of(changed, setup.comm, setup.given, setup.path)
    temporary = TemporaryDirectory(prefix="hydrabeam-") if folder is None and setup.comm.rank == 0 else None
    place = Path(setup.comm.bcast(temporary.name if temporary else str(folder)))
    with begun(setup) as (for_data, threads):
        run_sampling(setup, place, for_data, threads)
    found = Chains(place)
    if temporary is not None:
        weakref.finalize(found, temporary.cleanup)
    return found


def with_sample(job: Job, changes: dict[str, Any]) -> Job:
    """Return the job with other keys of ``[sample]``.

    Raises
    ------
    InputError
        If one cannot be used.
    """
    table = job.sample.model_dump(mode="json", exclude_none=True) | changes
    try:
        return job.model_copy(update={"sample": Sample.model_validate_json(json.dumps(table))})
    except ValidationError as error:
        wrong = as_input_error(error, Sample)
        wrong.within("[sample]")
        raise wrong from error


def run_sampling(setup: Setup, out: Path, folder: Path | None, threads: int) -> None:
    """Begin or go on with the chains of a setup. Collective: all ranks of the setup.

    Parameters
    ----------
    setup : Setup
    out : Path
        Folder of the chains.
    folder : Path, optional
        For simulated data.
    threads : int
        BLAS threads of this rank, for the record.
    """
    clock, world, wanted = Clock(), setup.comm, setup.job.sample
    _, problem, _ = prepare_checked(setup, folder, clock, told)
    group, chains = groups_of_chains(world, wanted.chains)
    # Of a problem with errors all groups tell together.
    with together(world):
        own = ProcessGrid.split(group, problem.observation.Nfreqs)
        walk = begin(read_context(own, problem, problem.of_channels(own.channels), clock))
    store = _open(world, setup, problem, walk, out, threads)
    with together(world), apart(world, group) as listen:
        run_chains(walk, store, chains, setup.job.seed, wanted.thin, listen)
    with together(world):
        if world.rank == 0:
            warn(diagnose(store).warnings())


def _open(world: Comm, setup: Setup, problem: Problem, walk: Walk, out: Path, threads: int) -> ChainStore:
    """Return the store on all ranks. Collective: all ranks of the setup."""
    wanted = setup.job.sample
    variables = variables_of(walk)
    with together(world):
        if world.rank == 0:
            about = origin_of(setup, problem, threads)
            identity = {"job": _same_of(setup.job), "sha256": about["sha256"]}
            if ChainStore.exists(out):
                store = ChainStore.open(out, identity)
                done = [store.n_draws(chain) for chain in range(store.chains)]
                say(f"going on with chains of {', '.join(map(str, done))} draws")
                store.extend(max(wanted.chains, store.chains), wanted.draws)
            else:
                description = {"basis": problem.basis.describe()}
                ChainStore.create(
                    out, identity, variables, wanted.chains, wanted.draws, wanted.warm_up, about | description
                )
    with together(world):
        return ChainStore.open(out)


def _same_of(job: Job) -> dict[str, Any]:
    """Return what a job must have in common with the chains that it goes on with."""
    table = job.model_dump(mode="json", exclude_none=True)
    for key in ("name", "output", "loop"):
        del table[key]
    for key in ("chains", "draws"):
        del table["sample"][key]
    return table
