"""The cross-polarised power beam of an unpolarised sky: forward model and inference against matvis with E-fields."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import matvis
import numpy as np
import pytest
import tomli_w
from astropy import units
from astropy.coordinates import SkyCoord
from astropy.time import Time
from mpi4py import MPI
from pyradiosky import SkyModel
from pyuvdata import UVBeam
from pyuvdata.analytic_beam import AnalyticBeam

import hydrabeam_mpi as hb
from hydrabeam_mpi.commands.infer import infer
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, Observation
from hydrabeam_mpi.io.beamfits import BeamFile
from hydrabeam_mpi.io.uvwrite import write_uvh5
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.random import complex_normal, generator
from tests.validation.test_simulators import ARRAYS, FREQS, SKY, difference, observe, ours

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:pyuvdata")


def field(za: FloatArray, az: FloatArray, leak: complex = 1.0) -> ComplexArray:
    """E-field by component and feed (e, n), (2, 2, Npoints); no symmetry, and phases that differ between feeds."""
    east, north, up = np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)
    lobe = np.exp(-2 * ((east - 0.1) ** 2 + (north + 0.05) ** 2)) * (0.2 + up)
    of_e = [lobe * (1 + 0.1 * east), leak * lobe * (0.2 * east * north + 0.1j * north)]
    of_n = [lobe * (0.15 * east * north - 0.12j * up * east), lobe * np.exp(0.3j * north)]
    return np.array([of_e, of_n]).swapaxes(0, 1)


def power(pol: str, za: FloatArray, az: FloatArray, leak: complex = 1.0) -> ComplexArray:
    """B_pq = sum over components of E_p E_q^*."""
    one, two = (field(za, az, leak)[:, "en".index(feed)] for feed in pol)
    return np.asarray(np.sum(one * two.conj(), axis=0))


@dataclass(kw_only=True, eq=False)
class Polarised(AnalyticBeam):
    """The same field as pyuvdata has it."""

    leak: complex = 1.0
    basis_vector_type: ClassVar[str] = "az_za"

    def _efield_eval(self, *, az_grid: FloatArray, za_grid: FloatArray, f_grid: FloatArray) -> ComplexArray:
        values = self._get_empty_data_array(az_grid.shape)
        values[:, :, :] = field(za_grid, az_grid, self.leak)
        return np.asarray(values)


FEEDS = {"feed_array": np.array(["x", "y"]), "feed_angle": np.array([np.pi / 2, 0.0]), "mount_type": "fixed"}


def by_matvis(observation: Observation, sky: Sky, beam: AnalyticBeam | UVBeam) -> dict[str, ComplexArray]:
    """Simulate all polarisations, each (Nfreqs, Ntimes, Nbls)."""
    order = observation.antenna_numbers.tolist()
    vis = matvis.simulate_vis(
        ants=dict(zip(order, observation.antpos, strict=True)),
        fluxes=sky.flux.T,
        ra=sky.ra,
        dec=sky.dec,
        freqs=observation.freqs,
        times=Time(observation.times, format="jd"),
        beams=[beam],
        telescope_loc=observation.location,
        precision=2,
        polarized=True,
        antpairs=np.array([[order.index(ant) for ant in pair] for pair in observation.antpairs.tolist()]),
        coord_method="CoordinateRotationAstropy",
    )
    return {one + two: vis[..., i, j] for i, one in enumerate("en") for j, two in enumerate("en")}


@pytest.mark.parametrize("array", ARRAYS)
def test_all_polarisations_of_an_unpolarised_sky(array: str) -> None:
    observation = observe(ARRAYS[array])
    theirs = by_matvis(observation, SKY, Polarised(**FEEDS))
    for pol, vis in theirs.items():
        mine = ours(observation, beam=lambda za, az, pol=pol: power(pol, za, az))
        assert difference(mine, vis) < 1e-12
    assert difference(theirs["en"], theirs["ne"]) > 0.1


N_SOURCES, N_TIMES = 1500, 24
NOISE = 0.05
"""Jy of the real and the imaginary part together."""
LEAK = 1.5 + 0.5j
"""By what the model beam has too much of a component of one of the feeds."""
JOB: dict[str, Any] = {
    "data": {"files": ["data.uvh5"]},
    "noise": {"kind": "constant", "sigma": NOISE},
    "sky": {"kind": "catalogue", "file": "sky.skyh5"},
    "beam": {"source": "beam.fits", "frequency": "match"},
    "basis": {"form": "complex", "n_modes": 300, "k_max": 20, "m_max": 8},
    "output": {"draws": 2},
}


POLS = ("ee", "nn", "en", "ne")


def write_observed(folder: Path, beam: AnalyticBeam | UVBeam, freq: float) -> None:
    """Write what matvis sees of many sources in all polarisations, with noise, and the sources."""
    once = observe(ARRAYS["hexagon"])
    times = once.times[0] + np.arange(N_TIMES) / 72
    observation = replace(
        once,
        freqs=np.array([freq]),
        channel_width=np.full(1, 1e5),
        times=times,
        lsts=Time(times, format="jd", location=once.location).sidereal_time("apparent").rad,
        integration_time=np.full(N_TIMES, 10.0),
        pols=POLS,
    )
    rng = generator(5, "sky")
    flux = 10 ** rng.uniform(-1, 1.5, (1, N_SOURCES))
    sky = Sky(rng.uniform(0, 2 * np.pi, N_SOURCES), np.arcsin(rng.uniform(-1, 1, N_SOURCES)), flux)
    seen = by_matvis(observation, sky, beam)
    data = np.stack([seen[pol] for pol in POLS], axis=-1)
    data += NOISE * complex_normal(generator(5, "noise"), data.shape)
    write_uvh5(folder / "data.uvh5", observation, data, np.zeros(data.shape, bool), np.ones(data.shape))
    SkyModel(
        name=[f"source {number}" for number in range(N_SOURCES)],
        skycoord=SkyCoord(sky.ra * units.rad, sky.dec * units.rad, frame="icrs"),
        stokes=np.stack([flux, *np.zeros((3, 1, N_SOURCES))]) * units.Jy,
        spectral_type="flat",
    ).write_skyh5(folder / "sky.skyh5")


def infer_from(folder: Path, name: str, job: dict[str, Any]) -> Path:
    """Infer from a job and return the result's folder."""
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(job))
    infer(MPI.COMM_SELF, load_job(path), path, folder / name, overwrite=False, threads=1)
    return folder / name


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data of all polarisations, an E-field that is nearly right, and what one job infers of all of them."""
    folder = tmp_path_factory.mktemp("polarised")
    write_observed(folder, Polarised(**FEEDS), float(FREQS[0]))
    grid = {"axis1_array": np.deg2rad(np.arange(360.0)), "axis2_array": np.deg2rad(np.arange(91.0))}
    model = Polarised(leak=LEAK, **FEEDS).to_uvbeam(freq_array=FREQS[:1], beam_type="efield", **grid)
    model.write_beamfits(str(folder / "beam.fits"))
    infer_from(folder, "together", {**JOB, "data": {**JOB["data"], "polarization": POLS}})
    return folder


@pytest.mark.parametrize("pol", ["en", "ne"])
def test_the_cross_polarised_beam_is_recovered(observed: Path, pol: str) -> None:
    out = observed / "together" / pol
    uvbeam = UVBeam.from_file(out / "beam.beamfits")
    # At the zenith all azimuthal orders are one, and few sources cross it.
    az, za = np.meshgrid(uvbeam.axis1_array, uvbeam.axis2_array[5:])
    true, model = power(pol, za, az), power(pol, za, az, LEAK)
    model /= np.sqrt(np.prod([power(one, za, az, LEAK).real.max() for one in ("ee", "nn")]))
    assert rms(uvbeam.data_array[0, 0, 0, 5:] - true) < 0.1 * rms(model - true) < 0.05 * rms(true)
    told = json.loads((out / "summary.json").read_text())
    assert 0.7 < told["heldout_chi2_predictive"] < 1.3 < 20 < told["heldout_chi2_unperturbed_scaled"]
    assert not [line for line in told["warnings"] if "negative" in line or "imaginary" in line]


@pytest.mark.parametrize("pol", ["ee", "ne"])
def test_together_is_as_alone(observed: Path, pol: str) -> None:
    """Of co-polarised data baselines and their reverses are one, of others two; the design is the same."""
    alone = hb.load(infer_from(observed, pol, {**JOB, "data": {**JOB["data"], "polarization": pol}}))
    together = hb.load(observed / "together")[pol]
    assert np.all(np.abs(together.beam.mean - alone.beam.mean) < 1e-9 * alone.beam.std)
    np.testing.assert_allclose(together.beam.std, alone.beam.std, rtol=1e-9)


def test_all_beams_are_in_one_file(observed: Path) -> None:
    uvbeam = UVBeam.from_file(observed / "together" / "beam.beamfits")
    assert uvbeam.polarization_array.tolist() == [-5, -6, -7, -8]
    for number, pol in enumerate(POLS):
        own = UVBeam.from_file(observed / "together" / pol / "beam.beamfits")
        np.testing.assert_array_equal(uvbeam.data_array[0, number], own.data_array[0, 0])
        assert np.iscomplexobj(own.data_array) == (pol[0] != pol[1])


def test_beams_of_a_dipole_are_recovered_at_once(data_dir: Path, tmp_path: Path) -> None:
    """All four products of the two feeds of an electromagnetic simulation, from a model with one component wrong."""
    path = data_dir / "models" / "HERA_Dipole_efield_100-101MHz.fits"
    true = UVBeam.from_file(path, freq_range=[99.9e6, 100.1e6])
    true.peak_normalize()
    write_observed(tmp_path, true, 100e6)
    model = true.copy()
    # The component along azimuth of the feed that points East.
    model.data_array[0, 0] *= 1.3
    model.write_beamfits(str(tmp_path / "beam.fits"))
    job = {**JOB, "data": {**JOB["data"], "polarization": POLS}}
    found = UVBeam.from_file(infer_from(tmp_path, "found", job) / "beam.beamfits")
    for number, pol in enumerate(POLS):
        beams = [BeamFile.of(one, "beam").beam(100e6, pol) for one in (true, model)]
        az, za = np.meshgrid(found.axis1_array, found.axis2_array[5:])
        expected, before = (one(za.ravel(), az.ravel()).reshape(za.shape) for one in beams)
        left = rms(found.data_array[0, number, 0, 5:] - expected)
        assert left < 0.08 * rms(expected)
        assert pol == "nn" or left < 0.03 * rms(before - expected)  # that feed is right in the model
        told = json.loads((tmp_path / "found" / pol / "summary.json").read_text())
        assert 0.7 < told["heldout_chi2_predictive"] < 1.3


def test_simulated_ones_have_the_noise_of_both_feeds(observed: Path) -> None:
    simulate = {"array": {"hex": [2, 3]}, "n_times": N_TIMES, "freqs": FREQS[:1].tolist(), "nsamples": 0.3}
    job = {**JOB, "data": {"simulate": simulate, "polarization": "en"}, "noise": {}, "sky": {"n_sources": 500}}
    out = infer_from(observed, "mock", job)
    assert 0.8 < json.loads((out / "summary.json").read_text())["heldout_chi2_predictive"] < 1.25


def rms(values: ComplexArray) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))
