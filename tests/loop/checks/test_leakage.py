"""Leakage between feeds is found in a file of four polarisations, and only where it is."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.fit.joint import find_setup
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.loop.checks.leakage import check_leakage
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.problem import prepare
from tests.loop.mock import mock_job, write_job
from tests.visibilities import NUMBERS, SECOND, make_uvdata

SIGMA = 0.05
JOB = """
[data]
files = ["data.uvh5"]
[noise]
kind = "constant"
sigma = 0.05
[sky]
n_sources = 50
[beam]
source = "airy"
diameter = 14.0
[basis]
n_modes = 20
k_max = 5
m_max = 2
"""
PAIRS = tuple((one, two) for k, one in enumerate(NUMBERS) for two in NUMBERS[k + 1 :])
TIMES = 2459866.2 + 300 * SECOND * np.arange(16)
D_TERMS = 0.03 * np.random.default_rng(3).normal(size=(2, len(NUMBERS), 2, 2)) @ [1, 1j]


def write(folder: Path, d: np.ndarray, polarised: float = 0.0, pols: tuple[int, ...] = (-5, -6, -7, -8)) -> None:
    """Write visibilities of random e and n with D-terms (Nfreqs, Nants, 2), and a job that reads them."""
    freqs = np.array([120e6, 121e6])
    uv = make_uvdata(times=TIMES, antpairs=PAIRS, pols=(-5, -6, -7, -8), freqs=freqs)
    rng = np.random.default_rng(5)
    shape = uv.data_array.shape[:2]
    one, two = (np.searchsorted(NUMBERS, ants) for ants in (uv.ant_1_array, uv.ant_2_array))

    def random(size: float) -> np.ndarray:
        return size * (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)

    ee = random(4.0)
    nn = 0.8 * ee + random(2.0)
    en, ne = random(polarised), random(polarised)
    for f in range(2):
        en[:, f] += d[f, one, 0] * nn[:, f] + d[f, two, 1].conj() * ee[:, f]
        ne[:, f] += d[f, one, 1] * ee[:, f] + d[f, two, 0].conj() * nn[:, f]
    uv.data_array = np.stack([vis + random(SIGMA) for vis in (ee, nn, en, ne)], axis=-1)
    with quiet():
        if len(pols) < 4:
            uv.select(polarizations=pols)
        uv.write_uvh5(folder / "data.uvh5", clobber=True)
    (folder / "job.toml").write_text(JOB)


def check(folder: Path, world: MPI.Comm = MPI.COMM_SELF) -> dict | None:
    job = load_job(folder / "job.toml")
    problem = prepare(job, (folder / "data.uvh5",))
    grid = ProcessGrid.split(world, problem.observation.Nfreqs)
    return check_leakage(grid, problem.of_channels(grid.channels), find_setup(problem))


def truth_of(name: str, freq: float) -> float:
    """Return the D-term that a parameter's name tells of."""
    _, antenna, _, feed, _, part, _ = name.replace(",", "").split()
    d = D_TERMS[round(freq / 1e6) - 120, NUMBERS.index(int(antenna)), "en".index(feed)]
    return d.real if part == "real" else d.imag


@pytest.mark.mpi
def test_leakage_is_found(comm: MPI.Comm, common_tmp_path: Path) -> None:
    if comm.rank == 0:
        write(common_tmp_path, D_TERMS)
    comm.barrier()
    found = check(common_tmp_path, comm)
    assert found is not None
    assert found["effect"] == "leakage"
    assert "reason" not in found
    assert found["log_bayes_factor"] > 100
    assert found["absorbed_by_beam"] == 0
    assert found["heldout_before"] > 3
    assert found["chi2_before"] > 3
    # The regressors' own noise, seen through D-terms of a few per cent, adds less than a hundredth.
    assert found["chi2_after"] == pytest.approx(1, abs=0.15)
    assert found["heldout_after"] == pytest.approx(1.05, abs=0.15)
    assert found["heldout_sigma"] > 5
    assert 0 < found["attenuation"] < 1e-3
    assert len(found["parameters"]) == 2 * 4 * len(NUMBERS)
    errors = [(one["value"] - truth_of(one["name"], one["freq_hz"])) / one["std"] for one in found["parameters"]]
    assert np.std(errors) == pytest.approx(1, abs=0.35)
    assert "cross-polarisations" in found["sentence"]


def test_one_leaking_antenna(tmp_path: Path) -> None:
    d = np.zeros_like(D_TERMS)
    d[:, 2, 1] = 0.05 - 0.02j
    write(tmp_path, d)
    found = check(tmp_path)
    assert found is not None
    assert {one["name"] for one in found["parameters"]} == {
        f"antenna {NUMBERS[2]} feed n leakage, {part} part" for part in ("real", "imaginary")
    }
    np.testing.assert_allclose([one["value"] for one in found["parameters"]], [0.05, -0.02] * 2, atol=0.005)


def test_no_leakage(tmp_path: Path) -> None:
    write(tmp_path, np.zeros_like(D_TERMS))
    assert check(tmp_path) is None


def test_a_polarised_sky_is_not_leakage(tmp_path: Path) -> None:
    write(tmp_path, 0.3 * D_TERMS, polarised=0.5)
    found = check(tmp_path)
    assert found is None or "reason" in found
    write(tmp_path, D_TERMS, polarised=0.4)
    found = check(tmp_path)
    assert found is not None
    assert found["log_bayes_factor"] > 5
    assert "too little" in found["reason"]


def test_missing_polarisations(tmp_path: Path) -> None:
    write(tmp_path, D_TERMS, pols=(-5, -6))
    found = check(tmp_path)
    assert found is not None
    assert set(found) == {"effect", "reason"}
    assert "ee, nn" in found["reason"]


@pytest.mark.parametrize("pol", ["ee", "nn"])
def test_simulated_leakage_is_found_by_the_loop(pol: str, tmp_path: Path) -> None:
    """Whichever feed the beam is inferred of; here no antenna's gain is off and no cross-polarisation is polarised."""
    leak = {"kind": "leakage", "strength": 0.5}
    job = mock_job(leak, loop={"effects": ["leakage", "antenna_gains"]})
    job["data"]["polarization"] = pol
    out = tmp_path / "result"
    assert main(["loop", str(write_job(job, tmp_path)), "-o", str(out)]) == 0
    told = json.loads((out / "loop.json").read_text())
    assert [one["effect"] for one in told["rounds"]] == ["leakage"]
    with h5py.File(out / "truth.h5") as file:
        (truth,) = json.loads(file.attrs["effects"])
    found = {one["name"]: one for one in told["rounds"][0]["parameters"]}
    assert found.keys() == set(truth["names"])
    values = dict(zip(truth["names"], truth["values"][0], strict=True))
    errors = [(one["value"] - values[name]) / one["std"] for name, one in found.items()]
    assert np.abs(errors).max() < 4
    assert "common leakage, c in d_e + c and d_n - c*" in [one["what"] for one in told["undecidable"]]
