"""The shipped jobs on measured HERA data, cut down to one channel and the brightest sources."""

from __future__ import annotations

import json
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from mpi4py import MPI
from pyradiosky import SkyModel
from pyuvdata import UVData

from hydrabeam_mpi.commands.infer import infer
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.row_buffer import RowBuffer
from hydrabeam_mpi.fit.rows import Rows, read_rows
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.loop.checks.health import check_health
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.setup.problem import estimate_noise, prepare

JOBS = Path(__file__).parents[2] / "jobs" / "hera_h1c"
CHANNEL = 48  # 175 MHz
FLUX_MIN = 1.0  # Jy at 180 MHz: 46% of the catalogue's flux, 9% of its sources


@pytest.fixture(scope="module")
def bright_sources(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The catalogue of the jobs without its faint sources, which is read in no time."""
    path = tmp_path_factory.mktemp("sky") / "bright.skyh5"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyradiosky's, about the format
        sky = SkyModel.from_file(str(data_dir / "models" / "GLEAM_KGS_Fornax_180MHz.sav"), filetype="fhd")
        sky.select(component_inds=(sky.stokes[0, 0].to_value("Jy") >= FLUX_MIN).nonzero()[0])
        sky.write_skyh5(str(path))
    return path


@pytest.fixture(scope="module")
def files(data_dir: Path) -> list[Path]:
    """Set B of the measured data."""
    return sorted((data_dir / "H1C_2458042_LST5.7").glob("*.uvh5_downselected"))


@pytest.fixture(scope="module")
def write_job(data_dir: Path, bright_sources: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Function that cuts down a shipped job, ``write_job("job.toml", files)``."""
    folder = tmp_path_factory.mktemp("measured")

    def write(name: str, files: list[Path]) -> Path:
        job = tomllib.loads((JOBS / name).read_text())
        job["data"] |= {"files": [str(file) for file in files], "channels": [CHANNEL]}
        job["sky"] |= {"file": str(bright_sources), "diffuse": str(data_dir / "models" / "gsm2016"), "flux_min": 0.0}
        job["beam"]["source"] = str(data_dir / "models" / "HERA_Dipole_efield_100-101MHz.fits")
        (folder / name).write_text(tomli_w.dumps(job))
        return folder / name

    return write


def summary_of(job: Path) -> dict[str, Any]:
    """Run a job and return its ``summary.json``."""
    out = job.with_suffix("")
    infer(MPI.COMM_SELF, load_job(job), job, out, overwrite=True, threads=1)
    return json.loads((out / "summary.json").read_text())


@pytest.fixture(scope="module")
def summary(write_job: Callable[..., Path], files: list[Path]) -> dict[str, Any]:
    """The result on the data as they are."""
    return summary_of(write_job("job.toml", files))


@pytest.mark.study
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
    assert summary["heldout_chi2_noise_only"] > 10


@pytest.mark.study
def test_measured_data_are_healthy_but_for_a_channel_width(write_job, data_dir):
    """Set A's files state the distance of their channels, 1.5625 MHz, as their width, which is 97.7 kHz."""
    night = sorted((data_dir / "H1C_2458043-45_LST1.1").glob("zen.2458043.*.HH.XRAA.uvh5"))
    path = write_job("nights.toml", night)
    job = tomllib.loads(path.read_text()) | {"holdout": {"kind": "times", "every": 2}}
    found = {}
    for name, noise in {"as shipped": job["noise"], "as stated": {"kind": "autocorrelations"}}.items():
        data = {key: value for key, value in job["data"].items() if name == "as shipped" or key != "channel_width"}
        path.write_text(tomli_w.dumps(job | {"noise": noise, "data": data}))
        problem = estimate_noise(MPI.COMM_SELF, prepare(load_job(path), tuple(night)))
        found[name] = check_health(ProcessGrid.split(MPI.COMM_SELF, problem.observation.Nfreqs), problem)
    assert found["as shipped"] == []
    (one,) = found["as stated"]
    width, unit = one.remedy.partition("'")[2].partition("'")[0].split()
    assert unit == "kHz"
    # Of one night; sixteen times the width is stated.
    assert float(width) == pytest.approx(97.65625, rel=0.2)


@pytest.mark.study
def test_conjugated_data_are_not_explained(write_job, files, summary, tmp_path):
    """The sign of the phase, that of the baselines and the place of the array are right only together."""
    copies = [tmp_path / path.name for path in files]
    for path, copy in zip(files, copies, strict=True):
        uv = UVData.from_file(str(path), file_type="uvh5", run_check=False)
        uv.data_array = uv.data_array.conj()
        uv.write_uvh5(str(copy), run_check=False)
    conjugated = summary_of(write_job("job.toml", copies))
    assert conjugated["heldout_explained_unperturbed_scaled"] < 0.1
    assert conjugated["heldout_explained"] < summary["heldout_explained"] - 0.4


@pytest.mark.study
def test_unseen_baselines_tell_an_error_of_the_beam_from_one_of_the_antennas(write_job, files):
    """Mock data of the measured array, sky and noise: the beam is right about unseen baselines if gains are."""
    job = load_job(write_job("baselines.toml", files))
    problem = estimate_noise(MPI.COMM_SELF, prepare(job, tuple(files)))
    train, test = read_rows(problem, problem.train), read_rows(problem, problem.test)
    train_design, test_design = (
        np.array([problem.basis.mix(parts[0, 0]) + 1j * problem.basis.mix(parts[0, 1]) for parts in columns])[
            :, rows.member
        ]
        for rows in (train, test)
        for columns in [problem.forward_model(rows.groups).design_columns(problem.basis, rows.tile.times)]
    )
    prior = problem.priors[0]
    antennas = np.searchsorted(problem.observation.antenna_numbers, problem.observation.antpairs)

    def explained(gain_error: float, seed: int) -> float:
        """Return the explained part of held-out mock data, whose beam is a draw from the prior."""
        rng = generator(seed, "unseen baselines", str(gain_error))
        coeffs = prior.mean + prior.std() * rng.standard_normal(problem.basis.n_modes)
        gains = (1 + gain_error * rng.standard_normal(6)) * np.exp(1j * gain_error * rng.standard_normal(6))
        product = gains[antennas[:, 0]] * gains[antennas[:, 1]].conj()
        product = np.where(problem.redundant.flipped, product.conj(), product)

        def mock(rows: Rows, design: np.ndarray) -> np.ndarray:
            weights = rows.inv_noise_var[0]
            sigma = np.divide(1, np.sqrt(weights), out=np.zeros(weights.shape), where=weights > 0)
            return (design @ coeffs) * product[rows.tile.bls] + sigma * complex_normal(rng, weights.shape)

        normal = NormalEquations([Block(BEAM, problem.basis.n_modes)])
        data, weights = mock(train, train_design).ravel(), train.inv_noise_var[0].ravel()
        rows = train_design.reshape(len(data), -1)
        normal.add_data(data, weights)
        buffer = RowBuffer(normal, BEAM)
        buffer.add(np.stack([rows.real, rows.imag]), weights * data, weights)
        buffer.flush()
        data, weights = mock(test, test_design), test.inv_noise_var[0]
        residual = data - test_design @ normal.gaussian({BEAM: prior}).solve().mean
        return 1 - float(np.sum(weights * np.abs(residual) ** 2) / np.sum(weights * np.abs(data) ** 2))

    assert min(explained(0.0, seed) for seed in range(20)) > 0.7
    assert max(explained(0.2, seed) for seed in range(20)) < 0
