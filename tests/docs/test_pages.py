"""All commands and all code in the README and in docs/ run.

Fenced blocks of a page are run in their order, in a folder with ``DATA.uvh5`` and jobs: ``bash`` as commands
(`hydrabeam` in this process, with or without mpiexec), ``python`` with ``hb``, ``uvd``, ``uvbeam`` and ``skymodel``,
``toml`` as a part of a job. ``sh`` is for what needs another machine, and only has to be shell.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from pyuvdata import AiryBeam, UVData

import hydrabeam_mpi as hb
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import Job

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#:]+)\)")
MODEL: dict[str, Any] = {
    "sky": {"n_sources": 100},
    "beam": {"source": "airy", "diameter": 14.0},
    "basis": {"n_modes": 100, "k_max": 24, "m_max": 8},
    "output": {"draws": 2},
    "loop": {"effects": ["antenna_gains", "timestamp"]},
    "sample": {"chains": 2, "draws": 20, "warm_up": 5},
}
SIMULATE: dict[str, Any] = {
    "array": {"hex": [2, 3]},
    "n_times": 24,
    "nsamples": 1.0,
    "perturb": {"stretch": [1.02, 1.02], "sidelobe": 0.0},
}
INJECTED = [{"kind": "antenna_gains", "parameters": {"antenna 3 ln amplitude": 0.1}}]


class Workspace:
    """A folder in which pages run their commands; one that has been run already is not run again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._done: set[str] = set()
        for name, start in (("DATA", 2459866.0), ("night2", 2459867.0)):
            simulate = SIMULATE | {"start": start, "effects": INJECTED}
            hb.simulate({"data": {"simulate": simulate}, **MODEL}).uvd.write_uvh5(folder / f"{name}.uvh5")
            (folder / f"{name}.toml").write_text(tomli_w.dumps({"data": {"files": [f"{name}.uvh5"]}, **MODEL}))
        (folder / "DATA.toml").rename(folder / "job.toml")
        (folder / "simulation.toml").write_text(tomli_w.dumps({"data": {"simulate": SIMULATE}, **MODEL}))
        both = {"simulate": SIMULATE, "polarization": ["ee", "nn"]}
        (folder / "both.toml").write_text(tomli_w.dumps({"data": both, **MODEL}))
        self.run("hydrabeam loop job.toml -o found")

    def run(self, line: str) -> None:
        """Run a line of a shell: a command of the program, or another one of its few neighbours."""
        told = shlex.split(line, comments=True)
        if "hydrabeam" not in told:
            subprocess.run(told, cwd=self.folder, check=True)
            return
        told = told[told.index("hydrabeam") + 1 :]
        if (key := " ".join(told)) in self._done:
            return
        if told[0] == "init":  # the jobs of this folder have the sky and the beam already
            told[told.index("-o") + 1] = "proposed.toml"
        with chdir(self.folder):
            assert main(told) == 0, line
        self._done.add(key)

    def names(self) -> dict[str, Any]:
        """Return what the lines of a page may use."""
        return {
            "hb": hb,
            "uvd": UVData.from_file(self.folder / "DATA.uvh5"),
            "uvbeam": AiryBeam(diameter=14.0, x_orientation="east"),
            "skymodel": MODEL["sky"],
        }


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    return Workspace(tmp_path_factory.mktemp("pages"))


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """Yield the language and the text of the fenced blocks of a page."""
    for found in BLOCK.finditer(page.read_text()):
        yield found[1], found[2]


def test_the_loop_of_the_readme_finds_the_gain(workspace: Workspace) -> None:
    found = hb.load(workspace.folder / "found")
    assert isinstance(found, hb.Found)
    assert found.verdict == "explained"
    assert [one["effect"] for one in found.rounds] == ["antenna_gains"]


def merged(table: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """Return a job with a part of another."""
    both = {key: merged(table[key], part[key]) for key in table.keys() & part if isinstance(table[key], dict)}
    beam_of_a_file = {"source", "diameter"} & table.keys() and "diameter" not in part and "source" in part
    kept = {key: value for key, value in table.items() if not (beam_of_a_file and key == "diameter")}
    return kept | part | both


RUN = [page for page in PAGES if {"bash", "python"} & {language for language, _ in blocks(page)}]
WITH_MANY_REPORTS = {"polarisations"}


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.study] * (page.stem in WITH_MANY_REPORTS)) for page in RUN],
    ids=lambda page: page.stem,
)
def test_what_a_page_shows_runs(page: Path, workspace: Workspace) -> None:
    names: dict[str, Any] = {}
    for language, text in blocks(page):
        if language == "bash":
            for line in text.replace("\\\n", " ").splitlines():
                workspace.run(line)
        elif language == "python":
            names = names or workspace.names()
            with chdir(workspace.folder):
                exec(text, names)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_shows_of_jobs_and_shells_is_right(page: Path) -> None:
    for language, text in blocks(page):
        if language == "toml":
            part = tomllib.loads(text)
            given = {"data": {"files": ["DATA.uvh5"]}} | MODEL
            simulated = {"data": {"simulate": SIMULATE}} | MODEL
            base = simulated if "simulate" in part.get("data", {}) else given
            Job.model_validate_json(json.dumps(merged(base, part)))
        elif language == "sh":
            assert "hydrabeam infer" not in text
            subprocess.run(["bash", "-n"], input=text, text=True, check=True)
        else:
            assert language in ("bash", "python", "text", "json"), f"a block in {language} is not run"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files(page: Path) -> None:
    linked = LINK.findall(re.sub(r"`[^`]*`|\$[^$]*\$", "", page.read_text()))
    assert [name for name in linked if not os.path.exists(page.parent / name)] == []
