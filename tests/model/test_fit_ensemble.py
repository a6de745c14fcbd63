"""Covariances of ensembles: known statistics recovered, always positive definite, and the tool that writes them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.beamfits import write_power_beam
from hydrabeam_mpi.model.bases import basis_from_description
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.rings import degree_grid
from hydrabeam_mpi.model.beam import analytic_beam
from hydrabeam_mpi.model.ensemble import fit_ensemble, summarise_ensemble
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.setup.beams import fit_model_beams, load_beams, make_prior

TOOL = Path(__file__).parents[2] / "tools" / "ensemble_prior"


def draws(n, covariance, is_complex):
    root = np.linalg.cholesky(covariance)
    rng = generator(1, "draws", n)
    noise = complex_normal(rng, (n, len(root))) if is_complex else rng.standard_normal((n, len(root)))
    return 3.0 + noise @ root.T


@pytest.mark.parametrize("is_complex", [False, True])
def test_many_beams_give_the_true_covariance(is_complex):
    truth = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, -0.5], [0.0, -0.5, 1e-6]]).astype(complex if is_complex else float)
    truth[2, 2] = 1.0
    if is_complex:
        truth[0, 1] += 1j
        truth[1, 0] -= 1j
    found = summarise_ensemble(draws(200_000, truth, is_complex), ridge=0.0)
    np.testing.assert_allclose(found.covariance, truth, atol=0.05)
    np.testing.assert_allclose(found.mean, 3, atol=0.03)
    assert found.shrinkage < 1e-3
    assert found.n_beams == 200_000


def test_few_beams_give_a_positive_definite_covariance_near_the_truth():
    truth = np.diag(np.logspace(0, -10, 40))
    found = summarise_ensemble(draws(10, truth, False), ridge=0.0)
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    # Independent coefficients: nearly all correlation seen in ten beams is chance, and is shrunk away.
    assert 0.8 < found.shrinkage <= 1


def test_shrinkage_lowers_the_error_of_a_small_ensemble():
    rng = generator(2, "factors")
    factors = rng.standard_normal((30, 5))
    truth = factors @ factors.T + np.eye(30)
    samples = draws(20, truth, False)
    found = summarise_ensemble(samples, ridge=0.0)
    assert 0 < found.shrinkage < 1
    assert np.linalg.norm(found.covariance - truth) < np.linalg.norm(np.cov(samples.T) - truth)


def test_ridge_is_added_to_the_diagonal():
    samples = draws(10, np.eye(3), False)
    with_ridge, without = summarise_ensemble(samples, 0.25).covariance, summarise_ensemble(samples, 0.0).covariance
    np.testing.assert_allclose(with_ridge - without, 0.25 * np.eye(3), atol=1e-14)


def test_too_little_is_refused():
    with pytest.raises(InputError, match="2 beams"):
        summarise_ensemble(np.ones((2, 3)), 1.0)
    with pytest.raises(InputError, match="ridge"):
        summarise_ensemble(np.ones((5, 3)), 0.0)


def test_ensemble_of_widths_varies_along_the_change_of_the_beam():
    basis = FourierBessel.full(10, 1)
    widths = [3.8, 3.9, 4.0, 4.1, 4.2]
    coeffs, rms = fit_ensemble([analytic_beam("gaussian", 150e6, diameter=d) for d in widths], basis)
    assert coeffs.shape == (5, basis.n_modes)
    assert (rms < 1e-3).all()
    covariance = summarise_ensemble(coeffs, 1e-20).covariance
    change = coeffs[4] - coeffs[0]
    along = change @ covariance @ change / (change @ change)
    assert along > 0.8 * np.trace(covariance)


JOB = """
seed = 3
[data.simulate]
freqs = ["131 MHz"]
[basis]
form = "{form}"
n_modes = 60
k_max = 20
m_max = 4
"""


def run_tool(*arguments):
    command = [sys.executable, str(TOOL), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(TOOL.parents[1]), "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)


@pytest.mark.parametrize("form", ["real", "complex"])
def test_tool_writes_a_prior_that_a_job_takes(tmp_path, form):
    job_path, out = tmp_path / "job.toml", tmp_path / "prior.h5"
    job_path.write_text(JOB.format(form=form))
    done = run_tool(job_path, out, "--n-beams", 6)
    assert done.returncode == 0, done.stderr
    with h5py.File(out) as file:
        mean, covariance = file["mean"][:], file["covariance"][:]
        basis = basis_from_description(json.loads(file.attrs["basis"]))
        assert file.attrs["n_beams"] == 6
        assert 0 < file.attrs["shrinkage"] <= 1
        assert file.attrs["ridge"] > 0
    assert basis.n_modes == len(mean) == 60
    assert basis.is_complex == (form == "complex")
    assert np.linalg.eigvalsh(covariance).min() > 0
    zenith = basis.synthesize(mean, np.zeros(1), np.zeros(1))[0].real
    assert zenith == pytest.approx(1.01, abs=0.02)

    job_path.write_text(JOB.format(form=form) + "[prior]\nkind = 'file'\nfile = 'prior.h5'\n")
    job = load_job(job_path)
    _, fits = fit_model_beams(job, load_beams(job, np.array([131e6]), "ee"))
    prior = make_prior(job, fits[0])
    np.testing.assert_array_equal(prior.mean, mean)
    np.testing.assert_allclose(prior.std(), np.sqrt(np.diag(covariance).real))


def test_tool_takes_beam_files(tmp_path):
    job_path, out = tmp_path / "job.toml", tmp_path / "prior.h5"
    job_path.write_text(JOB.format(form="real"))
    za, az = degree_grid()
    files = []
    for number, diameter in enumerate((13.5, 14.0, 14.5)):
        files.append(tmp_path / f"{number}.beamfits")
        values = analytic_beam("airy", 131e6, diameter=diameter)(za, az).reshape(1, 1, 91, 360)
        write_power_beam(files[-1], values, np.array([131e6]), ["ee"], telescope_name="test")
    done = run_tool(job_path, out, "--beams", *files)
    assert done.returncode == 0, done.stderr
    with h5py.File(out) as file:
        assert file.attrs["n_beams"] == 3
        assert "2.beamfits" in file.attrs["origin"]


def test_tool_tells_bad_input_in_one_line(tmp_path):
    job_path = tmp_path / "job.toml"
    job_path.write_text(JOB.format(form="real"))
    done = run_tool(job_path, tmp_path / "prior.h5", "--beams", tmp_path / "none.beamfits")
    assert done.returncode == 2
    assert done.stderr.strip().count("\n") == 0
    assert "no such file" in done.stderr
    assert not (tmp_path / "prior.h5").exists()
