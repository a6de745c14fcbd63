"""Data that were filtered in time or in frequency are named before any fit, and nothing else is called so."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVData
from scipy.signal.windows import dpss

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.simulation.mock import simulate_to
from tests.loop.checks.test_health import crosses, damaged, found
from tests.loop.mock import mock_job, write_job

N_TIMES = 24
Filter = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Of samples (Ntimes, Nfreqs) and whether they are known: what is left."""


def made(folder: Path, freqs: tuple[float, ...] = (131e6, 133e6), **changes: Any) -> dict[str, Any]:
    """Simulate ``data.uvh5`` in two hours and return a job that reads it."""
    job = mock_job(n_times=N_TIMES, freqs=freqs)
    job["data"]["simulate"] |= {"lst_range": ["6 h", "8 h"]} | changes
    simulate_to(MPI.COMM_SELF, load_job(write_job(job, folder)), folder)
    return {**job, "data": {"files": ["data.uvh5"]}, "noise": {"kind": "autocorrelations"}}


def taken_out(modes: np.ndarray) -> Filter:
    """Take the modes (N, K) out as they fit what is known best, in time or in frequency by their length."""

    def change(data: np.ndarray, known: np.ndarray) -> np.ndarray:
        axis = data.shape.index(len(modes))
        left = np.moveaxis(data, axis, 0).copy()
        for k, which in enumerate(np.moveaxis(known, axis, 0).T):
            fit = np.linalg.lstsq(modes[which], left[which, k], rcond=None)[0]
            left[:, k] -= modes @ fit
        return np.moveaxis(left, 0, axis)

    return change


def changed(change: Filter, *, share: float = 0.0) -> Callable[[UVData], None]:
    """Flag a share of the samples and filter each baseline."""

    def damage(uv: UVData) -> None:
        rng = np.random.default_rng(1)
        for pair in np.unique(uv.baseline_array[crosses(uv)]):
            rows = np.flatnonzero(uv.baseline_array == pair)
            rows = rows[np.argsort(uv.time_array[rows])]
            uv.flag_array[rows] |= (rng.random((len(rows), uv.Nfreqs)) < share)[..., np.newaxis]
            uv.data_array[rows, :, 0] = change(uv.data_array[rows, :, 0], ~uv.flag_array[rows, :, 0])

    return damage


def constants(n: int) -> np.ndarray:
    return np.ones((n, 1))


def fringes(low: int) -> np.ndarray:
    """Fourier modes up to some number of turns, as who zeroes fringe rates takes them out."""
    turns = 2 * np.pi * np.arange(1, low + 1) * np.arange(N_TIMES)[:, np.newaxis] / N_TIMES
    return np.concatenate([constants(N_TIMES), np.cos(turns), np.sin(turns)], axis=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("good")


@pytest.fixture(scope="module")
def job(folder: Path) -> dict[str, Any]:
    return made(folder)


THREE = "what varies slowest of it (at least 3 modes: fringe rates below about 0.21 mHz) holds"
IN_TIME = {
    "mean": (constants(N_TIMES), "its mean over the times holds"),
    "notch": (
        dpss(N_TIMES, 1.3, 3).T,
        "what varies slowest of it (at least 3 modes: fringe rates below about 0.21 mHz) holds",
    ),
    "fringes": (fringes(1), THREE),
}


@pytest.mark.parametrize("share", [0.0, 0.1])
@pytest.mark.parametrize("name", IN_TIME)
def test_in_time(name: str, share: float, job: dict[str, Any], folder: Path) -> None:
    modes, words = IN_TIME[name]
    assert found(job, folder, files=damaged(folder, changed(lambda data, _: data, share=share))) == []
    (one,) = found(job, folder, files=damaged(folder, changed(taken_out(modes), share=share)))
    assert (one.what, one.where, one.convention) == ("data filtered in time", "each baseline", "filtered in time")
    # Flags leave fewer series that tell many modes.
    assert one.why.startswith(words if not share or name == "mean" else "what varies slowest of it (at least 2 modes")
    assert ("cross_coupling" in one.remedy) == (name == "mean")


def noisier(uv: UVData) -> None:
    """Say that the noise is three times as large."""
    uv.nsample_array /= 9


def noise_alone(uv: UVData) -> None:
    """Put noise as the radiometer has it in the place of all data."""
    rng = np.random.default_rng(1)
    rows = np.flatnonzero(crosses(uv))
    powers = {
        (int(uv.ant_1_array[k]), uv.time_array[k]): uv.data_array[k].real for k in np.flatnonzero(~crosses(uv)).tolist()
    }
    for k in rows.tolist():
        one, two = (powers[int(ants[k]), uv.time_array[k]] for ants in (uv.ant_1_array, uv.ant_2_array))
        exposure = uv.integration_time[k] * uv.channel_width[:, np.newaxis] * uv.nsample_array[k]
        sigma = np.sqrt(one * two / exposure / 2)
        uv.data_array[k] = sigma * (rng.normal(size=sigma.shape) + 1j * rng.normal(size=sigma.shape))


def brighter(uv: UVData) -> None:
    """Make noise a thousandth of what it is beside the sky."""
    uv.nsample_array *= 1e6


@pytest.mark.parametrize("damage", [noisier, noise_alone, brighter])
def test_what_is_no_filter(damage: Callable[[UVData], None], job: dict[str, Any], folder: Path) -> None:
    names = [one.what for one in found(job, folder, files=damaged(folder, damage))]
    assert not [one for one in names if "filtered" in one]


def test_a_mean_is_found_where_noise_is_overstated(job: dict[str, Any], folder: Path) -> None:
    def both(uv: UVData) -> None:
        noisier(uv)
        changed(taken_out(constants(N_TIMES)))(uv)

    names = [one.what for one in found(job, folder, files=damaged(folder, both))]
    assert "data filtered in time" in names


def test_a_part_of_the_times_does_not_show_the_mean_of_all(job: dict[str, Any], folder: Path) -> None:
    """Its own mean is less than the model's, but not less than noise: nothing is claimed."""
    files = damaged(folder, changed(taken_out(constants(N_TIMES))))
    assert found(job, folder, files=files, lst_range=["6 h", "7 h"]) == []


@pytest.mark.parametrize("each", [True, False])
def test_several_nights(each: bool, tmp_path: Path) -> None:
    """The mean is taken from each night, or over all of them."""
    job = made(tmp_path, n_times=12, nights=3)
    assert found(job, tmp_path) == []
    modes = np.kron(np.eye(3), np.ones((12, 1))) if each else np.ones((36, 1))
    (one,) = found(job, tmp_path, files=damaged(tmp_path, changed(taken_out(modes))))
    assert one.where == ("each night of each baseline" if each else "each baseline")
    assert one.why.startswith("its mean over the times holds less than 1e-06 times the noise's power")
    assert ("cross_coupling" in one.remedy) != each


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_in_frequency(share: float, tmp_path: Path) -> None:
    """Foregrounds are gone by a delay filter, and nothing but noise is left."""
    freqs = 130e6 + 0.5e6 * np.arange(12)
    job = made(tmp_path, freqs=tuple(freqs.tolist()))
    assert found(job, tmp_path, files=damaged(tmp_path, changed(lambda data, _: data, share=share))) == []
    delays = dpss(12, 1.5, 4).T
    names = damaged(tmp_path, changed(taken_out(delays), share=share))
    (one,) = [one for one in found(job, tmp_path, files=names) if "filtered" in one.what]
    assert (one.what, one.where) == ("data filtered in frequency", "each baseline and time")
    assert one.convention == "filtered in frequency"
    assert "delays below about" in one.why


@pytest.mark.parametrize("data", [{"freqs": ["131 MHz"]}, {"time_range": [0.0, 1.0]}])
def test_a_single_channel_or_time(data: dict[str, Any], job: dict[str, Any], folder: Path) -> None:
    """There is nothing to look at."""
    if "time_range" in data:
        job = {**job, "holdout": {"kind": "none"}}
        with h5py.File(folder / "data.uvh5") as file:
            first = float(file["Header/time_array"][0])
        data = {"time_range": [first - 1e-4, first + 1e-4]}
    assert not [one for one in found(job, folder, **data) if "filtered" in one.what]


@pytest.mark.mpi
def test_the_same_on_any_number_of_ranks(comm: MPI.Comm, common_tmp_path: Path) -> None:
    job = mock_job(n_times=N_TIMES, freqs=tuple((130e6 + 0.5e6 * np.arange(8)).tolist()))
    if comm.rank == 0:
        made(common_tmp_path, freqs=tuple(job["data"]["simulate"]["freqs"]))
        damaged(common_tmp_path, changed(taken_out(constants(8)), share=0.1))
    comm.Barrier()
    job["data"] = {"files": ["damaged.uvh5"]}
    shared = found(job, common_tmp_path, comm)
    assert [one.what for one in shared] == ["data filtered in frequency"]
    comm.Barrier()
    alone = found(job, common_tmp_path / str(comm.rank), files=[str(common_tmp_path / "damaged.uvh5")])
    assert [one.line for one in shared] == [one.line for one in alone]


def run(command: str, job: dict[str, Any], folder: Path, name: str) -> dict[str, Any]:
    """Run a command and return what its result tells."""
    path = write_job(job, folder, f"{name}.toml")
    assert main([command, str(path), "-o", str(folder / name)]) == 0
    return json.loads((folder / name / ("loop.json" if command == "loop" else "summary.json")).read_text())


def means_of(path: Path) -> dict[str, float]:
    """Return the means that are taken out, by the names that parameters of constants have."""
    with quiet():
        uv = UVData.from_file(path)
    means = {}
    for pair in np.unique(uv.baseline_array[crosses(uv)]).tolist():
        rows = uv.baseline_array == pair
        mean = uv.data_array[rows, 0, 0].mean()
        name = "baseline {}-{}".format(*uv.baseline_to_antnums(pair))
        means |= {f"{name} real": mean.real, f"{name} imaginary": mean.imag}
    return means


def test_commands(tmp_path: Path) -> None:
    """The loop refuses, unless constants are asked for or in the job: these make up for a mean. `infer` warns."""
    job = made(tmp_path, freqs=(131e6,))
    job["data"] = {"files": damaged(tmp_path, changed(taken_out(constants(N_TIMES))))}
    told = run("loop", job, tmp_path, "loop")
    assert (told["verdict"], told["conventions"]["found"]) == ("convention", "filtered in time")
    assert "use data from before the filter, or" in told["conventions"]["remedy"]
    assert [one["title"] for one in told["rounds"]] == ["convention: filtered in time"]
    assert [one["what"] for one in told["health"]] == ["data filtered in time"]
    line = next(one for one in run("infer", job, tmp_path, "infer")["warnings"] if "filtered in time" in one)
    assert line in told["warnings"]

    asked = run("loop", {**job, "loop": {"effects": ["cross_coupling"]}}, tmp_path, "asked")
    assert (asked["verdict"], asked["conventions"]["found"]) == ("explained", None)
    assert [one["effect"] for one in asked["rounds"]] == ["cross_coupling"]
    means = means_of(tmp_path / "data.uvh5")
    away = [(one["value"] + means[one["name"]]) / one["std"] for one in asked["rounds"][0]["parameters"]]
    assert len(away) == len(means)
    assert np.sqrt(np.mean(np.square(away))) < 1.5
    assert main(["infer", str(tmp_path / "asked" / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    again = json.loads((tmp_path / "again" / "summary.json").read_text())
    assert not [one for one in again["warnings"] if "filtered" in one]
    assert again["channels"][0]["heldout_chi2_predictive"] == pytest.approx(1, abs=0.3)
