"""Calibrated rows and the evidence: it is that of the data as they were before gains were divided out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVCal, UVData

from hydrabeam_mpi.commands.infer import infer
from hydrabeam_mpi.commands.simulate import simulate
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.accumulate import accumulate_designs
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Estimate, Values
from hydrabeam_mpi.setup.job_file import load
from tests.loop.mock import context_of, mock_job, write_job

SIGMA = 0.02
FLUX_RANGE = (1.0, 10.0)


@pytest.fixture(scope="module")
def mock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulated visibilities."""
    folder = tmp_path_factory.mktemp("mock")
    path = write_job(mock_job(sky={"flux_range": list(FLUX_RANGE)}), folder)
    simulate(MPI.COMM_SELF, load(MPI.COMM_SELF, path), path, folder / "out", overwrite=False, threads=1)
    return folder / "out" / "data.uvh5"


def write_gains(uv: UVData, path: Path, convention: str, size: float) -> np.ndarray:
    """Write gains of about ``size`` in the sense of V_obs = g_i g_j* V_true and return them by antenna number."""
    cal = UVCal.new(
        cal_style="redundant",
        gain_convention=convention,
        jones_array=np.array([-5, -6]),
        telescope=uv.telescope.copy(),
        freq_array=uv.freq_array,
        channel_width=uv.channel_width,
        ant_array=uv.telescope.antenna_numbers,
        update_telescope_from_known=False,
        empty=True,
        time_array=uv.time_array[:1],
        integration_time=float(uv.integration_time[0]),
    )
    rng = np.random.default_rng(2)
    gains = size * rng.uniform(0.5, 2, cal.Nants_data) * np.exp(2j * np.pi * rng.random(cal.Nants_data))
    cal.gain_array[:] = (gains if convention == "divide" else 1 / gains)[:, None, None, None]
    cal.flag_array[:] = False
    cal.write_calh5(str(path), run_check=False)
    return gains


def inferred(folder: Path, visibilities: Path, scale: float, **data: Any) -> dict[str, Any]:
    """Infer with sky and noise times ``scale``, and return the numbers of the only channel."""
    job = mock_job(
        sky={"flux_range": [scale * flux for flux in FLUX_RANGE]}, noise={"kind": "constant", "sigma": scale * SIGMA}
    )
    job["data"] = {"files": [str(visibilities)], **data}
    path = write_job(job, folder)
    infer(MPI.COMM_SELF, load(MPI.COMM_SELF, path), path, folder / "result", overwrite=False, threads=1)
    with h5py.File(folder / "result" / "posterior.h5") as file:
        numbers = json.loads(file["channel_0000"].attrs["summary"])
        return {"mean": file["channel_0000/mean"][:], **numbers}


@pytest.mark.filterwarnings("ignore")  # pyuvdata's, on writing
@pytest.mark.parametrize("convention", ["divide", "multiply"])
def test_evidence_with_gains_is_that_of_the_data_before_them(mock: Path, convention: str, tmp_path: Path) -> None:
    """Data with gains in them, calibrated, have the density of the true ones over the gains' volume."""
    without = inferred(tmp_path / "without", mock, 1.0)
    uv = UVData.from_file(mock)
    gains = write_gains(uv, tmp_path / "gains.calh5", convention, size=3.0)
    by_number = dict(zip(uv.telescope.antenna_numbers.tolist(), gains, strict=True))
    one, two = (np.array([by_number[n] for n in ants.tolist()]) for ants in (uv.ant_1_array, uv.ant_2_array))
    product = one * two.conj()
    uv.data_array *= product[:, None, None]
    uv.write_uvh5(str(tmp_path / "observed.uvh5"), run_check=False)
    with_gains = inferred(tmp_path / "with", tmp_path / "observed.uvh5", 1.0, gains=[str(tmp_path / "gains.calh5")])
    # The same baselines at all times, of which two of three are fitted.
    cross = uv.ant_1_array != uv.ant_2_array
    log_volume = with_gains["n_data"] * np.mean(np.log(np.abs(product[cross]) ** 2))
    np.testing.assert_allclose(with_gains["mean"], without["mean"], rtol=1e-9, atol=1e-12)
    assert abs(log_volume) > 100
    assert with_gains["log_evidence"] == pytest.approx(without["log_evidence"] - log_volume, abs=1e-4)


@pytest.mark.filterwarnings("ignore")
def test_evidence_does_not_depend_on_the_scale_that_gains_share_with_the_sky(mock: Path, tmp_path: Path) -> None:
    """Gains thrice as large, under a sky and noise of a ninth, say the same of the same data."""
    uv, found = UVData.from_file(mock), {}
    for size in (1.0, 3.0):
        path = tmp_path / f"{size}.calh5"
        write_gains(uv, path, "divide", size)
        found[size] = inferred(tmp_path / f"{size}", mock, size**-2, gains=[str(path)])
    assert found[3.0]["n_data"] == found[1.0]["n_data"]
    assert found[3.0]["log_evidence"] == pytest.approx(found[1.0]["log_evidence"], rel=1e-9)


def test_effects_that_multiply_leave_the_noise_of_the_data_as_it_was(tmp_path: Path) -> None:
    context = context_of(mock_job(), tmp_path)
    effect = AntennaGains()
    n_params = len(effect.parameters(context.setup))
    x = np.random.default_rng(3).normal(0, 0.2, n_params)
    values = Values((Active.start(effect, context.setup, np.ones(n_params), x),))
    rows, _ = context.train.calibrated(Estimate(values, refit(context, Values()).fit.posteriors))
    assert np.ptp(rows.inv_noise_var / context.train.rows.inv_noise_var) > 0.1
    basis, designs = context.problem.basis, list(context.train.designs(values))
    before, after = (accumulate_designs(some, designs, basis)[0] for some in (context.train.rows, rows))
    assert after.log_det_inv_noise == pytest.approx(before.log_det_inv_noise, rel=1e-12)


@pytest.mark.filterwarnings("ignore")
def test_flux_scale_brings_data_and_noise_to_jy(mock: Path, tmp_path: Path) -> None:
    """Data a thousandth as large, with noise to match and their scale stated, give the same beam."""
    without = inferred(tmp_path / "without", mock, 1.0)
    uv = UVData.from_file(mock)
    uv.data_array *= 1e-3
    uv.write_uvh5(str(tmp_path / "small.uvh5"), run_check=False)
    job = mock_job(sky={"flux_range": list(FLUX_RANGE)}, noise={"kind": "constant", "sigma": 1e-3 * SIGMA})
    job["data"] = {"files": [str(tmp_path / "small.uvh5")], "flux_scale": 1e3}
    path = write_job(job, tmp_path / "scaled")
    out = tmp_path / "scaled" / "result"
    infer(MPI.COMM_SELF, load(MPI.COMM_SELF, path), path, out, overwrite=False, threads=1)
    with h5py.File(out / "posterior.h5") as file:
        np.testing.assert_allclose(file["channel_0000/mean"][:], without["mean"], rtol=1e-6, atol=1e-9)
        log_evidence = json.loads(file["channel_0000"].attrs["summary"])["log_evidence"]
    assert log_evidence == pytest.approx(without["log_evidence"], rel=1e-5)


@pytest.mark.filterwarnings("ignore")
def test_excluded_times_and_baselines_count_as_flagged(mock: Path, tmp_path: Path) -> None:
    uv = UVData.from_file(mock)
    times = np.unique(uv.time_array)
    bad_rows = (uv.ant_1_array == 1) & (uv.ant_2_array == 4) | (uv.time_array == times[3])
    excluded = inferred(
        tmp_path / "excluded",
        mock,
        1.0,
        exclude_baselines=[[4, 1]],
        exclude_times=[[times[3] - 1e-5, times[3] + 1e-5]],
    )
    uv.flag_array[bad_rows] = True
    uv.write_uvh5(str(tmp_path / "flagged.uvh5"), run_check=False)
    flagged = inferred(tmp_path / "flagged", tmp_path / "flagged.uvh5", 1.0)
    assert excluded["n_data"] == flagged["n_data"]
    np.testing.assert_allclose(excluded["mean"], flagged["mean"], rtol=1e-11)


def test_a_baseline_that_is_not_in_the_data_cannot_be_excluded(mock: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="antenna 99 is not in the data") as caught:
        inferred(tmp_path, mock, 1.0, exclude_baselines=[[1, 99]])
    assert caught.value.field == "[data] exclude_baselines"
