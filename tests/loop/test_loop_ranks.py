"""`hydrabeam loop` says and writes the same on any number of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import load_job
from tests.loop.mock import FREQ, mock_job, write_job
from tests.loop.test_loop_command import GAIN, TWO, assert_reproduced, channels_of, record_of

FEW = ["antenna_gains", "cross_coupling", "missing_sources", "catalogue_flux", "timestamp", "outliers"]
TOGETHER = {"frequency": {"kind": "gaussian-process", "length": 5e6}}
UNEVEN = "three channels that hang together"
JOBS = {
    "two channels": mock_job(GAIN, freqs=TWO, loop={"effects": FEW}),
    UNEVEN: mock_job(
        GAIN, freqs=(FREQ, FREQ + 1e6, FREQ + 3e6), n_times=8, prior=TOGETHER, loop={"effects": ["antenna_gains"]}
    ),
    "one channel, few times": mock_job(GAIN, n_times=4, holdout={"every": 2}, loop={"effects": FEW}),
}
RUN_ALL = """
import sys
from pathlib import Path
from hydrabeam_mpi.cli import main
for job in sorted(Path(sys.argv[1]).glob("*.toml")):
    assert main(["loop", str(job), "-o", str(Path(sys.argv[2]) / job.stem)]) == 0
assert main(["infer", sys.argv[3], "-o", str(Path(sys.argv[2]) / "again")]) == 0
"""


@pytest.fixture(scope="module")
def jobs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("jobs")
    for name, job in JOBS.items():
        write_job(job, folder, f"{name}.toml")
    return folder


@pytest.fixture(scope="module")
def on_one_rank(jobs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one")
    for name in JOBS:
        assert main(["loop", str(jobs / f"{name}.toml"), "-o", str(folder / name)]) == 0
    return folder


@pytest.fixture(scope="module", params=[2, pytest.param(5, marks=pytest.mark.study)])
def on_many_ranks(
    request: pytest.FixtureRequest, jobs: Path, on_one_rank: Path, tmp_path_factory: Any, mpiexec_python: Any
) -> Path:
    """Two have one and two of three channels, or half of the times; five are more than there are."""
    folder: Path = tmp_path_factory.mktemp(f"ranks{request.param}")
    amended = on_one_rank / "two channels" / "amended.toml"
    done = mpiexec_python(request.param, RUN_ALL, jobs, folder, amended, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder


def assert_alike(one: Any, other: Any, where: str) -> None:
    """Compare records: words as they are, numbers but for rounding, which fits go on to magnify."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key in one.keys() - {"seconds"}:
            assert_alike(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, list):
        assert len(one) == len(other), where
        for i, pair in enumerate(zip(one, other, strict=True)):
            assert_alike(*pair, f"{where}[{i}]")
    elif isinstance(one, float):
        assert other == pytest.approx(one, rel=1e-4, abs=1e-5), where
    else:
        assert one == other, where


@pytest.mark.parametrize("job", [name for name in JOBS if name != UNEVEN])
def test_record_on_any_number_of_ranks(job: str, on_one_rank: Path, on_many_ranks: Path) -> None:
    one, many = (record_of(folder / job) for folder in (on_one_rank, on_many_ranks))
    assert one["verdict"] == "explained"
    assert_alike(one, many, "")


@pytest.mark.parametrize("job", JOBS)
def test_posterior_and_amendment_on_any_number_of_ranks(job: str, on_one_rank: Path, on_many_ranks: Path) -> None:
    for one, many in zip(channels_of(on_one_rank / job), channels_of(on_many_ranks / job), strict=True):
        assert np.all(np.abs(many["mean"] - one["mean"]) < 1e-5 * one["std"])
        np.testing.assert_allclose(many["std"], one["std"], rtol=1e-6)
    one, many = (load_job(folder / job / "amended.toml") for folder in (on_one_rank, on_many_ranks))
    for first, second in zip(one.effects, many.effects, strict=True):
        assert (first.kind, first.names, first.index) == (second.kind, second.names, second.index)
        shift = np.abs(np.array(first.values) - np.array(second.values))
        assert np.all(shift < 1e-5 * np.array(first.std))


def test_the_amended_job_on_any_number_of_ranks(on_one_rank: Path, on_many_ranks: Path) -> None:
    """As the loop has it on one."""
    assert_reproduced(on_one_rank / "two channels", on_many_ranks / "again")


def test_more_ranks_than_groups_of_baselines(tmp_path: Path, mpiexec_python: Any) -> None:
    """Two antennas have one baseline: two of three ranks have nothing of it when the data themselves are checked."""
    job = mock_job(n_times=6, data={"exclude_antennas": [0, 1, 2, 3, 4]}, loop={"effects": ["antenna_gains"]})
    path = write_job(job, tmp_path)
    assert main(["infer", str(path), "-o", str(tmp_path / "one")]) == 0
    code = "import sys; from hydrabeam_mpi.cli import main; sys.exit(main(sys.argv[1:]))"
    done = mpiexec_python(3, code, "infer", path, "-o", tmp_path / "three")
    assert done.returncode == 0, done.stderr
    (one,), (three,) = (channels_of(tmp_path / name) for name in ("one", "three"))
    assert np.all(np.abs(three["mean"] - one["mean"]) < 1e-8 * one["std"])
