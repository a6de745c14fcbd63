"""Small mock data with an effect in them, and the loop's view of these data."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import tomli_w
from mpi4py import MPI

from hydrabeam_mpi.api.preparation import prepare_shared_each
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint import read_context
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.job_file import load

FREQ = 131e6


def mock_job(
    *injected: dict[str, Any], freqs: tuple[float, ...] = (FREQ,), n_times: int = 12, **changes: dict[str, Any]
) -> dict[str, Any]:
    """Return a job: seven antennas, a hundred sources, and a round beam that is not quite the model's.

    The basis can represent it far below the noise, of a thousandth of the autocorrelations.
    """
    simulate = {
        "array": {"hex": [2, 3]},
        "n_times": n_times,
        "freqs": list(freqs),
        "nsamples": 1.0,
        "perturb": {"stretch": [1.02, 1.02], "sidelobe": 0.0},
        "effects": list(injected),
    }
    job: dict[str, Any] = {
        "name": "mock",
        "seed": 4,
        "data": {"simulate": simulate},
        "holdout": {"every": 3},
        "sky": {"n_sources": 100},
        "beam": {"source": "airy", "diameter": "14 m"},
        "basis": {"n_modes": 24, "k_max": 24, "m_max": 0},
        "output": {"draws": 2},
    }
    for table, keys in changes.items():
        job[table] = {**job.get(table, {}), **keys}
    return job


def write_job(job: dict[str, Any], folder: Path, name: str = "job.toml") -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    (folder / name).write_text(tomli_w.dumps(job))
    return folder / name


def context_of(job: dict[str, Any], folder: Path, world: MPI.Comm = MPI.COMM_SELF) -> FitContext:
    """Simulate, and read the data as the loop does. Collective: all ranks of `world`."""
    if world.rank == 0:
        write_job(job, folder)
    world.Barrier()
    (problem,) = prepare_shared_each(world, load(world, folder / "job.toml"), folder)
    grid = ProcessGrid.split(world, problem.observation.Nfreqs)
    return read_context(grid, problem, problem.of_channels(grid.channels), Clock())


def truth_of(folder: Path) -> list[dict[str, Any]]:
    """Return what was injected."""
    with h5py.File(folder / "truth.h5") as file:
        return list(json.loads(file.attrs["effects"]))
