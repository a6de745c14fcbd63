"""What an installation without extras, or without MPI, says: one line with the remedy."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from hydrabeam_mpi.extras import EXTRAS

ROOT = Path(__file__).parents[1]
WITHOUT = """
import sys
class Without:
    def find_spec(self, name, *_):
        if name.partition(".")[0] == sys.argv[1]:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Without())
"""
RUN = "from hydrabeam_mpi.cli import main; sys.exit(main(sys.argv[2:]))"
WITHOUT_MPI = """
import sys
class Without:
    def find_spec(self, name, *_):
        if name == "mpi4py.MPI":
            raise RuntimeError("cannot load MPI library\\nlibmpi.so: no such file\\nlibmpi.so.12: no such file")
sys.meta_path.insert(0, Without())
from hydrabeam_mpi.__main__ import main
sys.exit(main())
"""


def test_they_are_those_of_the_installation() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(EXTRAS) <= set(project["optional-dependencies"])
    assert [module for modules in EXTRAS.values() for module in modules if find_spec(module) is None] == []


@pytest.mark.parametrize(
    ("module", "extra", "command"),
    [
        ("matplotlib", "plot", "report out"),
        ("xarray", "chains", "sample job.toml -o out"),
        ("finufft", "nufft", "infer job.toml -o out"),
    ],
)
def test_a_command_names_what_it_lacks(module: str, extra: str, command: str, tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text('[data.simulate]\n[solver]\nengine = "nufft"\n')
    words = [sys.executable, "-c", WITHOUT + RUN, module, *command.split()]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert module in run.stderr
    assert f"pip install 'hydrabeam_mpi[{extra}]'" in run.stderr


def test_python_names_what_it_lacks() -> None:
    ask = "import hydrabeam_mpi as hb; print(hb.load_chains.__name__); hb.sample"
    words = [sys.executable, "-c", WITHOUT + ask, "arviz_stats"]
    run = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=False)
    assert run.stdout == "load_chains\n"
    assert run.stderr.endswith(
        "InputError: sample: needs arviz_stats, which is not installed; pip install 'hydrabeam_mpi[chains]'\n"
    )


@pytest.mark.parametrize("words", [["--version"], ["infer", "job.toml", "-o", "out"]])
def test_without_mpi(words: list[str]) -> None:
    """As the wheel of mpi4py fails where there is no library. Of several tasks the first one says so."""
    said = {}
    for task in ("0", "1"):
        environment = {**os.environ, "SLURM_STEP_NUM_TASKS": "2", "SLURM_PROCID": task}
        command = [sys.executable, "-c", WITHOUT_MPI, *words]
        run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, check=False)
        assert (run.returncode, run.stdout) == (2, "")
        said[task] = run.stderr
    assert said["0"].startswith("hydrabeam: error: mpi4py finds no MPI (cannot load MPI library); ")
    assert "pip install 'hydrabeam_mpi[mpi]'" in said["0"]
    assert said["0"].count("\n") == 1
    assert said["1"] == ""
