"""Chains from Python and from the command line: they begin, go on, and refuse those of another job."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hydrabeam_mpi as hb
from hydrabeam_mpi.cli import main
from tests.loop.mock import write_job
from tests.sampling.small import COUPLING, FLUX, small_job


def test_chains_go_on_and_are_of_one_job(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """By a command and then from Python; the draws are those of one run."""
    path = write_job(small_job(FLUX, COUPLING, n_modes=8, warm_up=2, chains=2), tmp_path)
    folder = tmp_path / "chains"
    assert main(["sample", str(path), "-o", str(folder), "--draws", "3"]) == 0
    before = hb.load_chains(folder).read("catalogue_flux")
    setup = hb.Setup.from_job(path)
    found = hb.sample(setup, folder, draws=6)
    assert {name: found.read(name).shape for name in found.names} == {
        "beam": (2, 6, 1, 8),
        "catalogue_flux": (2, 6, 2),
        "cross_coupling": (2, 6, 1, 4),
    }
    np.testing.assert_array_equal(found.read("catalogue_flux")[:, :3], before)
    whole = hb.sample(setup, draws=6)
    np.testing.assert_allclose(whole.read("beam"), found.read("beam"), rtol=1e-9)
    capfd.readouterr()
    assert main(["sample", "--status", str(folder)]) == 0
    assert "8 of 8" in capfd.readouterr().out
    with pytest.raises(hb.InputError, match="false in the job"):
        hb.sample(setup, folder, collapsed=False)
    other = write_job(small_job(FLUX, COUPLING, n_modes=9, warm_up=2, chains=2), tmp_path, "other.toml")
    assert main(["sample", str(other), "-o", str(folder)]) == 2
    assert "n_modes: is 8 in the chains, and 9 in the job" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sample"], "sample: needs a job and a folder"),
        (["sample", "--status", "nowhere"], "nowhere"),
    ],
)
def test_what_is_missing_is_told_in_a_line(arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert words in line


def test_blocks_that_do_not_exist_are_refused(tmp_path: Path) -> None:
    setup = hb.Setup.from_job(write_job(small_job(), tmp_path))
    with pytest.raises(hb.InputError, match="blocks"):
        hb.sample(setup, blocks=["beams"])
