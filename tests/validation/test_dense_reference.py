"""The whole pipeline against an inference written out with dense matrices, from the same files and nothing else.

The reference takes the data from the uvh5 file by pyuvdata, the sources from ``truth.h5``, the modes and the prior
from ``posterior.h5``, and computes the rest in the plainest way: every basis function by its formula, every
visibility of every baseline as a sum over sources, every matrix in full. What is left is rounding: with the GEMM
engine the means differ by 5e-10 of their standard deviation and the covariances by 3e-13, with the NUFFT engine by
3e-9 and 1e-12, and the numbers of ``summary.json`` by 1e-9.
"""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVData
from scipy.special import jn_zeros, jv

from hydrabeam_mpi.commands.infer import infer
from hydrabeam_mpi.commands.simulate import simulate
from hydrabeam_mpi.config import load_job

TABLE = Path(__file__).parents[2] / "hydrabeam_mpi" / "tables" / "hera_vivaldi_131MHz.h5"
C = 299792458.0
EDGE = np.deg2rad(92)
SKY = """
seed = 3
[sky]
n_sources = 200
"""
SIMULATION = """
[data.simulate]
array = { hex = [3, 5], spacing = "14.6 m" }
lst_range = ["6 h", "12 h"]
n_times = 8
nsamples = 1
"""
INFERENCE = """
[data]
files = ["observed.uvh5"]
[basis]
form = "{form}"
boundary = "{boundary}"
n_modes = 80
k_max = 10
m_max = 4
[prior]
fraction = 0.5
[solver]
engine = "{engine}"
compress = {compress}
"""
KINDS = [("real", "neumann"), ("complex", "dirichlet")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Simulated data, made less even: flags over nonsense, and a number of samples for each visibility."""
    folder = tmp_path_factory.mktemp("dense")
    (folder / "simulate.toml").write_text(SKY + SIMULATION)
    job = folder / "simulate.toml"
    simulate(MPI.COMM_SELF, load_job(job), job, folder / "mock", overwrite=False, threads=1)
    uv = UVData.from_file(folder / "mock" / "data.uvh5")
    rng = np.random.default_rng(1)
    cross = (uv.ant_1_array != uv.ant_2_array)[:, np.newaxis, np.newaxis]
    uv.flag_array |= cross & (rng.random(uv.flag_array.shape) < 0.1)
    uv.data_array[uv.flag_array] = 1e5
    uv.nsample_array[:] = np.where(cross, rng.integers(1, 9, uv.nsample_array.shape) / 4, 1)
    uv.write_uvh5(folder / "observed.uvh5")
    return folder


@dataclass
class Inferred:
    """What the pipeline wrote."""

    modes: list
    arrays: dict
    summary: dict


def run_pipeline(folder, form, boundary, engine, compress):
    job = INFERENCE.format(form=form, boundary=boundary, engine=engine, compress=str(compress).lower())
    (folder / "infer.toml").write_text(SKY + job)
    job = folder / "infer.toml"
    infer(MPI.COMM_SELF, load_job(job), job, folder / "out", overwrite=True, threads=1)
    with h5py.File(folder / "out" / "posterior.h5") as file:
        channel = file["channel_0000"]
        arrays = {name: channel[name][:] for name in ("mean", "covariance", "prior_mean", "prior_std")}
        return Inferred(json.loads(file.attrs["basis"])["modes"], arrays, json.loads(channel.attrs["summary"]))


@dataclass
class Rows:
    """Visibilities and what is known of them, one a row; all baselines turned towards the East."""

    time: np.ndarray
    vector: np.ndarray
    data: np.ndarray
    variance: np.ndarray

    def of(self, chosen):
        return Rows(self.time[chosen], self.vector[chosen], self.data[chosen], self.variance[chosen])


def antenna_positions(telescope):
    """East, north and up of the file's positions, which lie along the Earth's axes.

    pyuvdata's own conversion goes by the distance from the Earth's centre and is good to 1e-9 m only, which is 1e-5 of
    the posterior's standard deviation.
    """
    lon, lat = telescope.location.lon.rad, telescope.location.lat.rad
    x, y, z = telescope.antenna_positions.T
    outward = np.cos(lon) * x + np.sin(lon) * y
    east, north = np.cos(lon) * y - np.sin(lon) * x, np.cos(lat) * z - np.sin(lat) * outward
    return np.stack([east, north, np.sin(lat) * z + np.cos(lat) * outward], axis=1)


def read_rows(path):
    """List the unflagged visibilities, sigma^2 = V_11 V_22 / (dt dnu n); then sidereal times, latitude, frequency."""
    uv = UVData.from_file(path)
    position = dict(zip(uv.telescope.antenna_numbers.tolist(), antenna_positions(uv.telescope), strict=True))
    rows = []
    for one, two in uv.get_antpairs():
        if one == two:
            continue
        vector = position[two] - position[one]
        reverse = vector[0] < -1e-6 or (abs(vector[0]) <= 1e-6 and vector[1] < 0)
        data, flags = uv.get_data(one, two)[:, 0], uv.get_flags(one, two)[:, 0]
        autos = uv.get_data(one, one)[:, 0].real * uv.get_data(two, two)[:, 0].real
        variance = autos / (uv.channel_width[0] * uv.integration_time[0] * uv.get_nsamples(one, two)[:, 0])
        for time in np.flatnonzero(~flags):
            oriented = (-vector, data[time].conj()) if reverse else (vector, data[time])
            rows.append((time, *oriented, variance[time]))
    lsts = uv.lst_array[np.unique(uv.time_array, return_index=True)[1]]
    columns = map(np.array, zip(*rows, strict=True))
    return Rows(*columns), lsts, uv.telescope.location.lat.rad, uv.freq_array[0]


def source_directions(ra, dec, lst, lat):
    """Unit vectors (east, north, up): the sphere turned by the sidereal time, then by the latitude."""
    hour_angle = lst - ra
    x, y, z = np.cos(dec) * np.cos(hour_angle), -np.cos(dec) * np.sin(hour_angle), np.sin(dec)
    return np.array([y, np.cos(lat) * z - np.sin(lat) * x, np.sin(lat) * z + np.cos(lat) * x])


ZEROS = {"dirichlet": jn_zeros(0, 80), "neumann": [0.0, *jn_zeros(1, 79)]}


def radial_function(k, boundary, rho):
    """J0(u rho), normalised; u is a zero of J0, or of its derivative."""
    u = ZEROS[boundary][k - 1]
    return np.sqrt(2) * jv(0, u * rho) / (jv(1, u) if boundary == "dirichlet" else np.abs(jv(0, u)))


def azimuthal_function(m, form, az):
    if form == "complex":
        return np.exp(1j * m * az) / np.sqrt(360)
    if m == 0:
        return np.ones_like(az) / np.sqrt(360)
    return (np.cos(m * az) if m > 0 else np.sin(-m * az)) / np.sqrt(180)


def basis_functions(modes, form, boundary, directions):
    """Every function at every source, (Nsrc, Nmodes)."""
    east, north, up = directions
    rho, az = np.sqrt(1 - up) / np.sqrt(1 - np.cos(EDGE)), np.arctan2(north, east)
    return np.array([radial_function(k, boundary, rho) * azimuthal_function(m, form, az) for k, m in modes]).T


def model_beam(directions):
    """The built-in beam at every source, (Nsrc, 1), from its table of a_km: a_k(-m) is the conjugate of a_km."""
    with h5py.File(TABLE) as file:
        table, boundary = file["coeffs"][:], file.attrs["boundary"]
    modes = [(k + 1, m) for m in range(table.shape[0]) for k in range(table.shape[1])]
    weights = np.array([table[m, k - 1] * (2 if m else 1) for k, m in modes])
    return (basis_functions(modes, "complex", boundary, directions) @ weights).real[:, np.newaxis]


@dataclass
class RowBlock:
    """Sky and place."""

    ra: np.ndarray
    dec: np.ndarray
    flux: np.ndarray
    lsts: np.ndarray
    lat: float
    freq: float

    def see(self, rows, functions):
        """V = 1/2 sum_s I_s f(s) exp(2 pi i nu b.s/c) over the sources above the horizon, (Nrows, Nfunctions)."""
        seen = []
        for lst in self.lsts:
            directions = source_directions(self.ra, self.dec, lst, self.lat)
            up = directions[2] >= 0
            seen.append((directions[:, up], 0.5 * self.flux[up, np.newaxis] * functions(directions[:, up])))
        matrix = []
        for time, vector in zip(rows.time, rows.vector, strict=True):
            directions, apparent = seen[time]
            matrix.append(np.exp(2j * np.pi * self.freq / C * (vector @ directions)) @ apparent)
        return np.array(matrix)


def in_parts(form, matrix, data, variance):
    """For real coefficients real and imaginary parts are data of their own, each with half of the variance."""
    if form == "complex":
        return matrix, data, variance
    stacked = np.concatenate([matrix.real, matrix.imag])
    return stacked, np.concatenate([data.real, data.imag]), np.concatenate([variance, variance]) / 2


def log_normal_density(form, residual, covariance):
    """ln N(residual; 0, covariance), circular for complex data."""
    kappa, volume = (1, np.pi) if form == "complex" else (2, 2 * np.pi)
    quadratic = np.vdot(residual, np.linalg.solve(covariance, residual)).real
    return -(np.linalg.slogdet(volume * covariance)[1] + quadratic) / kappa


def infer_densely(folder, form, boundary, inferred):
    """Return mean, covariance and the numbers of ``summary.json``."""
    rows, *place = read_rows(folder / "observed.uvh5")
    with h5py.File(folder / "mock" / "truth.h5") as truth:
        block = RowBlock(truth["ra"][:], truth["dec"][:], truth["flux"][0], *place)
    functions = partial(basis_functions, inferred.modes, form, boundary)
    mu, sigma = inferred.arrays["prior_mean"], inferred.arrays["prior_std"]

    used = rows.of(rows.time % 2 == 0)
    design = block.see(used, functions)
    a, d, n = in_parts(form, design, used.data, used.variance)
    precision = a.conj().T @ np.diag(1 / n) @ a + np.diag(1 / sigma**2)
    mean = np.linalg.solve(precision, a.conj().T @ np.diag(1 / n) @ d + mu / sigma**2)
    covariance = np.linalg.inv(precision)
    marginal = a @ np.diag(sigma**2) @ a.conj().T + np.diag(n)
    numbers = {
        "n_data": len(used.data),
        "log_evidence": log_normal_density(form, d - a @ mu, marginal),
        "train_chi2": np.mean(np.abs(used.data - design @ mean) ** 2 / used.variance),
    }
    kept = rows.of(rows.time % 2 == 1)
    before = block.see(kept, model_beam)[:, 0]
    return mean, covariance, numbers | predict(form, kept, block.see(kept, functions), mean, covariance, before)


def predict(form, rows, design, mean, covariance, before):
    """Held-out residuals over the square root of noise plus model variance; real and imaginary parts apart."""
    parts = np.stack([design.real, design.imag] if form == "real" else [design / np.sqrt(2)] * 2)
    model_variance = np.einsum("pri,ij,prj->pr", parts, covariance, parts.conj()).real
    total = rows.variance / 2 + model_variance
    residual, raw = (np.stack([r.real, r.imag]) for r in (rows.data - design @ mean, rows.data - before))
    z, z_before = residual / np.sqrt(total), raw / np.sqrt(rows.variance / 2)
    power = np.sum(np.abs(rows.data) ** 2 / rows.variance)
    return {
        "heldout_n": len(rows.data),
        "ppd_z_std": z.std(),
        "ppd_z_max": np.abs(z).max(),
        "ppd_z_std_unperturbed": z_before.std(),
        "ppd_z_max_unperturbed": np.abs(z_before).max(),
        "heldout_log_density": np.sum(-(z**2) / 2 - np.log(2 * np.pi * total) / 2),
        "heldout_chi2_noise_only": np.mean(np.sum(residual**2, axis=0) / rows.variance),
        "heldout_chi2_predictive": np.mean(z**2),
        "heldout_chi2_unperturbed": np.mean(np.sum(raw**2, axis=0) / rows.variance),
        "heldout_explained": 1 - np.sum(residual**2 / rows.variance) / power,
        "heldout_explained_unperturbed": 1 - np.sum(raw**2 / rows.variance) / power,
    }


@pytest.fixture(scope="module")
def expected(folder):
    """``expected(form, boundary, inferred)``: the dense inference, made once for each kind of basis."""
    known = {}

    def compute(form, boundary, inferred):
        if (form, boundary) not in known:
            known[form, boundary] = infer_densely(folder, form, boundary, inferred)
        return known[form, boundary]

    return compute


@pytest.mark.parametrize("compress", [True, False], ids=["compressed", "uncompressed"])
@pytest.mark.parametrize("engine", ["gemm", "nufft"])
@pytest.mark.parametrize(("form", "boundary"), KINDS)
def test_pipeline_is_the_dense_inference(folder, expected, form, boundary, engine, compress):
    inferred = run_pipeline(folder, form, boundary, engine, compress)
    assert inferred.summary["n_unique_baselines"] == (30 if compress else 171)
    mean, covariance, numbers = expected(form, boundary, inferred)
    std = np.sqrt(np.diag(covariance).real)
    assert np.all(np.abs(inferred.arrays["mean"] - mean) < 1e-8 * std)
    assert np.all(np.abs(inferred.arrays["covariance"] - covariance) < 1e-8 * np.outer(std, std))
    assert {name: inferred.summary[name] for name in numbers} == pytest.approx(numbers, rel=1e-8)
