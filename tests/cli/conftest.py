"""A tiny simulated observation, job files that use it, and the program run on them."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from mpi4py import MPI

from hydrabeam_mpi.cli import main

OnRoot = Callable[[Callable[[], Any]], Any]

# Seven antennas, a few sources and modes: a run takes a second.
SIMULATION: dict[str, Any] = {
    "name": "tiny",
    "seed": 1,
    "data": {
        "simulate": {
            "array": {"hex": [2, 3]},
            "lst_range": ["6 h", "7 h"],
            "n_times": 4,
            "freqs": ["131 MHz"],
        }
    },
    "sky": {"n_sources": 50},
    "basis": {"n_modes": 16, "k_max": 8, "m_max": 4},
    "output": {"draws": 2},
}


def changed(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of a job with keys replaced; "data.files" is the key files of [data], None removes a key."""
    table = copy.deepcopy(table)
    for dotted, value in changes.items():
        *parents, key = dotted.split(".")
        section = table
        for parent in parents:
            section = section.setdefault(parent, {})
        if value is None:
            section.pop(key, None)
        else:
            section[key] = value
    return table


@dataclass(frozen=True)
class Workspace:
    """A folder of a test, with job files that infer from the simulated data."""

    folder: Path
    simulated: Path

    def job(self, changes: dict[str, Any] | None = None, name: str = "job.toml") -> Path:
        """Write a job file on measured-like data, changed as asked."""
        table = changed(SIMULATION, {"data.simulate": None, "data.files": [str(self.data)], **(changes or {})})
        return self.write(name, tomli_w.dumps(table))

    def simulation(self, changes: dict[str, Any] | None = None, name: str = "job.toml") -> Path:
        """Write a job file that simulates its data, changed as asked."""
        return self.write(name, tomli_w.dumps(changed(SIMULATION, changes or {})))

    def write(self, name: str, text: str) -> Path:
        """Write a text file."""
        (self.folder / name).write_text(text)
        return self.folder / name

    @property
    def data(self) -> Path:
        """The simulated visibilities."""
        return self.simulated / "data.uvh5"


@pytest.fixture(scope="session")
def simulated(comm: MPI.Comm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that ``hydrabeam simulate`` wrote."""
    folder = comm.bcast(tmp_path_factory.mktemp("simulated"))
    job = folder / "job.toml"
    if comm.rank == 0:
        job.write_text(tomli_w.dumps(SIMULATION))
    comm.Barrier()
    assert main(["simulate", str(job), "-o", str(folder / "result")]) == 0
    return folder / "result"


@pytest.fixture(scope="session")
def result(comm: MPI.Comm, simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that ``hydrabeam infer`` wrote."""
    folder = comm.bcast(tmp_path_factory.mktemp("inferred"))
    job = folder / "job.toml"
    if comm.rank == 0:
        Workspace(folder, simulated).job()
    comm.Barrier()
    assert main(["infer", str(job), "-o", str(folder / "result")]) == 0
    return folder / "result"


@pytest.fixture
def workspace(common_tmp_path: Path, simulated: Path) -> Workspace:
    """A folder that all ranks share."""
    return Workspace(common_tmp_path, simulated)


@pytest.fixture
def on_root(comm: MPI.Comm) -> OnRoot:
    """Run a function on rank 0 and give its result to all."""
    return lambda function: comm.bcast(function() if comm.rank == 0 else None)


def refusal(capfd: pytest.CaptureFixture[str], comm: MPI.Comm) -> str:
    """Return the one line of complaint of all ranks; else rank 0 tells its progress, and the others are silent."""
    out, err = capfd.readouterr()
    assert not out
    lines = err.splitlines()
    complaints = [line for line in lines if line.startswith("hydrabeam: error: ")]
    assert all(line.startswith("hydrabeam: ") for line in lines)
    if comm.rank > 0:
        assert lines == complaints
    if complaints:
        assert lines[-1] == complaints[-1]
    (complaint,) = (line for of_rank in comm.allgather(complaints) for line in of_rank)
    return complaint
