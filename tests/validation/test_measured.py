"""The shipped job on measured HERA data, cut down to one channel and the brightest sources."""

from __future__ import annotations

import json
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from mpi4py import MPI
from pyradiosky import SkyModel
from pyuvdata import UVData

from hydrabeam_mpi.run import infer

JOB = Path(__file__).parents[2] / "jobs" / "hera_h1c" / "job.toml"
CHANNEL = 48  # 175 MHz
FLUX_MIN = 1.0  # Jy at 180 MHz: 46% of the catalogue's flux, 9% of its sources


@pytest.fixture(scope="module")
def bright_sources(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The catalogue of the job without its faint sources, which is read in no time."""
    path = tmp_path_factory.mktemp("sky") / "bright.skyh5"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyradiosky's, about the format
        sky = SkyModel.from_file(str(data_dir / "models" / "GLEAM_KGS_Fornax_180MHz.sav"), filetype="fhd")
        sky.select(component_inds=(sky.stokes[0, 0].to_value("Jy") >= FLUX_MIN).nonzero()[0])
        sky.write_skyh5(str(path))
    return path


@pytest.fixture(scope="module")
def run_job(
    data_dir: Path, bright_sources: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[list[Path]], dict[str, Any]]:
    """Function that runs the job on some files and returns its ``summary.json``."""
    folder = tmp_path_factory.mktemp("measured")

    def run(files: list[Path]) -> dict[str, Any]:
        job = tomllib.loads(JOB.read_text())
        job["data"] |= {"files": [str(file) for file in files], "channels": [CHANNEL]}
        job["sky"] |= {"file": str(bright_sources), "diffuse": str(data_dir / "models" / "gsm2016"), "flux_min": 0.0}
        job["beam"]["source"] = str(data_dir / "models" / "HERA_Dipole_efield_100-101MHz.fits")
        (folder / "job.toml").write_text(tomli_w.dumps(job))
        infer(MPI.COMM_SELF, folder / "job.toml", folder / "out", overwrite=True, threads=1)
        return json.loads((folder / "out" / "summary.json").read_text())

    return run


@pytest.fixture(scope="module")
def files(data_dir: Path) -> list[Path]:
    """Set B of the measured data."""
    return sorted((data_dir / "H1C_2458042_LST5.7").glob("*.uvh5_downselected"))


@pytest.fixture(scope="module")
def summary(run_job: Callable[[list[Path]], dict[str, Any]], files: list[Path]) -> dict[str, Any]:
    """The result on the data as they are."""
    return run_job(files)


def test_the_inferred_beam_explains_more_of_data_that_it_has_not_seen(summary):
    assert summary["freq_hz"] == 175e6
    assert summary["n_unique_baselines"] == 15
    # Even with the model beam's amplitude fitted to the held-out data themselves.
    assert summary["heldout_explained_unperturbed"] < summary["heldout_explained_unperturbed_scaled"] < 0.6
    assert summary["heldout_explained"] > summary["heldout_explained_unperturbed_scaled"] + 0.1
    assert summary["heldout_rms_jy"] < 0.8 * summary["heldout_rms_jy_unperturbed_scaled"]
    assert summary["beam_fwhm_ew_deg"] == pytest.approx(summary["beam_fwhm_ew_deg_model"], rel=0.2)
    # And says what that does not prove.
    assert "takes up errors that are not its own" in " ".join(summary["warnings"])
    assert summary["heldout_chi2"] > 10


def test_conjugated_data_are_not_explained(run_job, files, summary, tmp_path):
    """The sign of the phase, that of the baselines and the place of the array are right only together."""
    copies = [tmp_path / path.name for path in files]
    for path, copy in zip(files, copies, strict=True):
        uv = UVData.from_file(str(path), file_type="uvh5", run_check=False)
        uv.data_array = uv.data_array.conj()
        uv.write_uvh5(str(copy), run_check=False)
    conjugated = run_job(copies)
    assert conjugated["heldout_explained_unperturbed_scaled"] < 0.1
    assert conjugated["heldout_explained"] < summary["heldout_explained"] - 0.4
