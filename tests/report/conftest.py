"""Small results of real runs: the paper's experiment in miniature, and four channels of data without truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest
import tomli_w
from mpi4py import MPI

from hydrabeam_mpi.commands.infer import infer
from hydrabeam_mpi.commands.simulate import simulate
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.report.document import write_report
from hydrabeam_mpi.report.page.result import Channel, load_result

PAPER: dict[str, Any] = {
    "name": "paper",
    "seed": 3,
    "data": {"simulate": {"array": {"hex": [2, 3]}, "n_times": 8}},
    "sky": {"n_sources": 200},
    "basis": {"form": "complex", "n_modes": 40},
    "output": {"draws": 2},
}
BANDS: dict[str, Any] = {
    "name": "bands <&>",
    "sky": {"n_sources": 200},
    "beam": {"source": "airy", "diameter": "14 m"},
    "basis": {"n_modes": 20, "k_max": 12, "m_max": 6},
    "prior": {"kind": "flat"},
    "output": {"draws": 2},
}
FREQS = ["120 MHz", "130 MHz", "140 MHz", "150 MHz"]

# Without these a report has few figures, and is quick.
BULK = (
    *("map_mean", "map_std", "map_model", "map_truth", "z_counts", "eigen_beams", "eigen_variances"),
    *("heldout_data", "baseline_chi2"),
)
Edit = Callable[[Path, Callable[[dict[str, Any]], None]], Path]


def write_job(path: Path, job: dict[str, Any]) -> Path:
    path.write_text(tomli_w.dumps(job))
    return path


def _run(command: Callable[..., None], job: Path, out: Path) -> None:
    command(MPI.COMM_SELF, load_job(job), job, out, overwrite=False, threads=1)


@pytest.fixture(scope="session")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One channel, complex coefficients, truth and held-out times; with its report."""
    folder = tmp_path_factory.mktemp("paper")
    _run(infer, write_job(folder / "job.toml", PAPER), folder / "result")
    write_report(folder / "result")
    return folder / "result"


@pytest.fixture(scope="session")
def bands(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four channels, real coefficients, flat prior, neither truth nor held-out data; with its report.

    The last two have no maps, so that it is quick.
    """
    folder = tmp_path_factory.mktemp("bands")
    mock = BANDS | {"data": {"simulate": {"array": {"hex": [2, 3]}, "n_times": 8, "freqs": FREQS}}}
    _run(simulate, write_job(folder / "mock.toml", mock), folder / "mock")
    job = BANDS | {"data": {"files": [str(folder / "mock" / "data.uvh5")]}, "holdout": {"kind": "none"}}
    _run(infer, write_job(folder / "job.toml", job), folder / "result")
    with h5py.File(folder / "result" / "posterior.h5", "r+") as file:
        for channel in ("channel_0002", "channel_0003"):
            for name in set(BULK) & file[channel].keys():
                del file[channel][name]
    write_report(folder / "result")
    return folder / "result"


@pytest.fixture
def paper_channel(paper: Path) -> Channel:
    return load_result(paper).channels[0]


@pytest.fixture
def bands_channel(bands: Path) -> Channel:
    return load_result(bands).channels[0]


@pytest.fixture
def edited(tmp_path: Path) -> Edit:
    """``edited(result, change)`` copies a result without its report and changes the copy's summary."""

    def edit(source: Path, change: Callable[[dict[str, Any]], None]) -> Path:
        copy = tmp_path / "edited"
        copy.mkdir()
        shutil.copy(source / "posterior.h5", copy)
        summary = json.loads((source / "summary.json").read_text())
        change(summary)
        (copy / "summary.json").write_text(json.dumps(summary))
        return copy

    return edit


def drop_arrays(result: Path, *names: str) -> None:
    """Remove data sets from the first channel of a posterior, and the numbers that it has of itself."""
    with h5py.File(result / "posterior.h5", "r+") as file:
        for name in names:
            del file["channel_0000"][name]
        file["channel_0000"].attrs["summary"] = "{}"
