"""The same job on any number of ranks gives the same result, whatever the ranks have to do.

Reference is one rank, in this process. The runs under mpiexec see idle ranks (five ranks for three times), baselines
shared out as well as times, groups of ranks that share a channel, and ranks that treat several channels.
"""

import json

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVData

from hydrabeam_mpi.commands.infer import infer
from hydrabeam_mpi.config import load_job

COMMON = """
seed = 5
[data.simulate]
array = {{ hex = [2, 3] }}
n_times = {n_times}
freqs = [{freqs}]
nsamples = 1
[holdout]
{holdout}
[sky]
n_sources = 150
[beam]
frequency = "scale"
[basis]
form = "{form}"
n_modes = 40
k_max = 8
m_max = 3
[output]
draws = 3
"""
JOBS = {
    "one channel": COMMON.format(n_times=6, freqs="131e6", holdout="every = 2", form="complex"),
    "three channels": COMMON.format(n_times=6, freqs="130e6, 131e6, 132e6", holdout="every = 2", form="real"),
    "nothing held out": COMMON.format(n_times=2, freqs="131e6", holdout='kind = "none"', form="real"),
    "baselines held out": COMMON.format(
        n_times=2, freqs="131e6, 132e6", holdout='kind = "baselines"\nantpairs = [[0, 1], [2, 5]]', form="complex"
    ),
}
TOGETHER = """
[prior.frequency]
kind = "gaussian-process"
kernel = "matern-5/2"
length = "4 MHz"
solver = "{}"
"""
for solver in ("dense", "conjugate-gradients"):
    JOBS[f"hanging together, {solver}"] = JOBS["three channels"] + TOGETHER.format(solver)
RUN_ALL = """
import sys
from pathlib import Path
from hydrabeam_mpi.cli import main
for job in sorted(Path(sys.argv[1]).glob("*.toml")):
    assert main(["infer", str(job), "-o", str(Path(sys.argv[2]) / job.stem)]) == 0
"""
# Of the run itself, not of its result.
OF_THE_RUN = {"ranks", "threads_per_rank", "wall_s", "phases_s", "peak_rss_mb"}


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("jobs")
    for name, text in JOBS.items():
        (folder / f"{name}.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def on_one_rank(jobs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("one")
    for name in JOBS:
        job = jobs / f"{name}.toml"
        infer(MPI.COMM_SELF, load_job(job), job, folder / name, overwrite=False, threads=1)
    return folder


@pytest.fixture(scope="module", params=[pytest.param(2, marks=pytest.mark.study), 5])
def on_many_ranks(request, jobs, tmp_path_factory, mpiexec_python):
    folder = tmp_path_factory.mktemp(f"ranks{request.param}")
    done = mpiexec_python(request.param, RUN_ALL, jobs, folder, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder


def channels(folder):
    """Read the arrays of every channel."""
    with h5py.File(folder / "posterior.h5") as file:
        names = [name for name in file if name.startswith("channel")]
        return [{key: file[name][key][:] for key in file[name]} for name in names]


@pytest.mark.parametrize("job", JOBS)
def test_data(job, on_one_rank, on_many_ranks):
    one, many = (UVData.from_file(folder / job / "data.uvh5").data_array for folder in (on_one_rank, on_many_ranks))
    np.testing.assert_allclose(many, one, rtol=0, atol=1e-13 * np.abs(one).max())


@pytest.mark.parametrize("job", JOBS)
def test_posterior(job, on_one_rank, on_many_ranks):
    pairs = list(zip(channels(on_one_rank / job), channels(on_many_ranks / job), strict=True))
    assert len(pairs) == JOBS[job].count("e6")
    for one, many in pairs:
        std = one["std"]
        assert np.all(np.abs(many["mean"] - one["mean"]) < 1e-8 * std)
        # Sums in another order differ by rounding, and an inverse by that times the condition number of the matrix.
        scale = np.outer(std, std)
        rounding = np.finfo(np.float64).eps * np.linalg.cond(one["covariance"] / scale)
        assert np.all(np.abs(many["covariance"] - one["covariance"]) < max(rounding, 1e-10) * scale)
        assert np.all(np.abs(many["draws"] - one["draws"]) < 1e-8 * std)
        np.testing.assert_array_equal(many["z_counts"], one["z_counts"])
        np.testing.assert_allclose(many["map_mean"], one["map_mean"], rtol=0, atol=1e-8 * one["map_std"].max())
        np.testing.assert_allclose(many["map_std"], one["map_std"], rtol=1e-9)
        sampled = [name for name in one if name.startswith(("heldout", "baseline"))]
        assert len(sampled) == (0 if job == "nothing held out" else 6)
        for name in sampled:
            largest = np.abs(one[name]).max()
            np.testing.assert_allclose(many[name], one[name], rtol=0, atol=1e-6 * largest)  # in single precision


@pytest.mark.parametrize("job", JOBS)
def test_summary(job, on_one_rank, on_many_ranks):
    one, many = (json.loads((folder / job / "summary.json").read_text()) for folder in (on_one_rank, on_many_ranks))
    assert one.keys() == many.keys()
    assert many["warnings"] == one["warnings"]
    for part, reference in zip([many, *many["channels"]], [one, *one["channels"]], strict=True):
        numbers = {key: value for key, value in reference.items() if isinstance(value, int | float)}
        assert len(numbers) > 10
        for key in numbers.keys() - OF_THE_RUN:
            assert part[key] == pytest.approx(numbers[key], rel=1e-8, abs=1e-12), key
