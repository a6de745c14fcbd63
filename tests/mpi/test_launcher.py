"""Tasks that do not see each other do not each do the whole run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.launchers import LAUNCHERS
from hydrabeam_mpi.mpi.launcher import check_one_world

Runner = Callable[..., subprocess.CompletedProcess[str]]
PROGRAM = (sys.executable, "-m", "hydrabeam_mpi")


@pytest.mark.parametrize("size", LAUNCHERS)
def test_one_of_several_tasks_is_refused(size: str) -> None:
    with pytest.raises(InputError, match=rf"1 rank, but {size}=4: each .*; launch with srun --mpi=.* unset {size}"):
        check_one_world(MPI.COMM_SELF, {size: "4", LAUNCHERS[size]: "0"})


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"SLURM_STEP_NUM_TASKS": "1", "SLURM_PROCID": "0"},
        # A shell or a script within an allocation of four tasks.
        {"SLURM_NTASKS": "4", "SLURM_NPROCS": "4", "SLURM_PROCID": "0", "PBS_NP": "4"},
        {"PMI_SIZE": ""},
    ],
)
def test_one_task_is_one_run(environment: dict[str, str]) -> None:
    check_one_world(MPI.COMM_SELF, environment)


def test_it_is_said_once(tmp_path: Path) -> None:
    """Two tasks as srun starts them where it knows of no MPI."""
    said = []
    for task in ("0", "1"):
        environment = {**os.environ, "SLURM_STEP_NUM_TASKS": "2", "SLURM_PROCID": task}
        words = (*PROGRAM, "infer", "no.toml", "-o", tmp_path / "out")
        ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        assert (ended.returncode, ended.stdout) == (2, "")
        said.append(ended.stderr)
    assert said[0].startswith("hydrabeam: error: 1 rank, but SLURM_STEP_NUM_TASKS=2: ")
    assert said[0].count("\n") == 1
    assert said[1] == ""


def test_ranks_of_one_world_go_on(mpiexec: Runner) -> None:
    """The launcher's own variables say two as well, and the job is looked at."""
    ended = mpiexec(2, *PROGRAM, "infer", "no.toml", "-o", "out", SLURM_STEP_NUM_TASKS="2")
    assert ended.returncode == 2
    assert ended.stderr.startswith("hydrabeam: error: no.toml: cannot be read")
