"""`hydrabeam sample` with chains that are of another job or damaged, and on a disk that takes no more."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.sampling.storage.store import ChainStore
from tests.cli.conftest import Workspace

DRAWS = 12
SAMPLE = {"sample.blocks": ["beam", "noise"], "sample.chains": 1, "sample.draws": DRAWS, "sample.warm_up": 2}


def run(job: Path, out: Path, *more: str) -> int:
    return main(["sample", str(job), "-o", str(out), *more])


def last_line(capfd: pytest.CaptureFixture[str]) -> str:
    return capfd.readouterr().err.splitlines()[-1]


def damage(out: Path) -> None:
    (path,) = (out / "chain-0").glob("*.h5")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - 400])


def test_damaged_chains_and_those_of_another_job(workspace: Workspace, capfd: pytest.CaptureFixture[str]) -> None:
    job, out = workspace.job(SAMPLE), workspace.folder / "chains"
    assert run(job, out) == 0
    whole = ChainStore.open(out).read("beam", 0)

    changes: tuple[tuple[dict[str, Any], str], ...] = (
        ({"seed": 2}, "job seed: is 1 in the chains, and 2 in the job"),
        ({"basis.n_modes": 15}, "job basis n_modes: is 16 in the chains, and 15 in the job"),
        ({"sample.blocks": ["beam"]}, 'job sample blocks: is ["beam", "noise"] in the chains, and ["beam"] in the job'),
    )
    for change, told in changes:
        capfd.readouterr()
        assert run(workspace.job({**SAMPLE, **change}, "other.toml"), out) == 2
        assert last_line(capfd).startswith(f"hydrabeam: error: {out / 'chains.json'}: {told}; name another folder")
    np.testing.assert_array_equal(ChainStore.open(out).read("beam", 0), whole)

    damage(out)
    n = ChainStore.open(out).n_draws(0)
    assert 0 < n < DRAWS + 2
    assert main(["sample", "--status", str(out)]) == 0
    assert f"{n} of {DRAWS + 2}" in capfd.readouterr().out
    assert run(job, out) == 0
    told = f"is truncated or damaged: of chain 0 the first {n} draws are kept, which are whole; what is damaged"
    assert told in capfd.readouterr().err
    again = ChainStore.open(out).read("beam", 0)
    np.testing.assert_allclose(again, whole, atol=1e-9 * whole.std(axis=0).min())


def test_a_disk_that_takes_no_more(small_disk: Path, workspace: Workspace, capfd: pytest.CaptureFixture[str]) -> None:
    out = small_disk / "chains"
    assert run(workspace.job(SAMPLE), out, "--draws", "1500") == 2
    line = last_line(capfd)
    assert line.startswith(f"hydrabeam: error: {out}")
    assert "cannot be written (No space left on device)" in line
    assert f"the first {ChainStore.open(out).n_draws(0)} draws of chain 0 are kept" in line


def test_an_interrupted_run_says_what_is_kept(workspace: Workspace, capfd: pytest.CaptureFixture[str]) -> None:
    job, out = workspace.job({**SAMPLE, "sample.draws": 1_000_000}), workspace.folder / "interrupted"

    def interrupt() -> None:
        while not (out / "chain-0").is_dir():
            time.sleep(0.05)
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    watcher = threading.Thread(target=interrupt)
    watcher.start()
    assert run(job, out) == 130
    watcher.join()
    n = ChainStore.open(out).n_draws(0)
    assert n > 0
    assert f"kept in {out}: chains of {n} draws, from where the same command goes on" in capfd.readouterr().err


def test_a_file_in_place_of_a_folder(workspace: Workspace, capfd: pytest.CaptureFixture[str]) -> None:
    job, out = workspace.job(SAMPLE), workspace.folder / "occupied"
    out.mkdir()
    (out / "chain-0").touch()
    assert run(job, out) == 2
    assert last_line(capfd) == f"hydrabeam: error: {out / 'chain-0'}: -o: is no folder; remove it"


def test_folders_that_have_no_chains(workspace: Workspace, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["sample", "--status", str(workspace.folder)]) == 2
    assert last_line(capfd).endswith("chains.json: no such file; name a folder that 'hydrabeam sample' wrote")
