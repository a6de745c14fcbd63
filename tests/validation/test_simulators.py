"""The forward model against simulators that share no code with it: matvis, fftvis and pyuvsim.

All three follow the sources with astropy, have the factor 1/2, and drop what is below the horizon, so that nothing
but rounding is left. The differences found are 4e-14 of the largest visibility (GEMM engine) and 2e-12 (NUFFT
engine, which is asked for 1e-12); through a file, whose antenna positions are relative to the Earth's centre, 4e-10.
"""

import sys
import warnings
from dataclasses import dataclass, replace
from functools import cache

import fftvis
import h5py
import matvis
import numpy as np
import pytest
from astropy import units
from astropy.coordinates import EarthLocation, SkyCoord
from astropy.time import Time
from mpi4py import MPI
from pyradiosky import SkyModel
from pyuvdata import AiryBeam, UniformBeam, UVBeam, UVData
from pyuvdata.analytic_beam import AnalyticBeam

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.io.beamfits import write_power_beam
from hydrabeam_mpi.io.uvwrite import write_uvh5
from hydrabeam_mpi.model.arrays import hexagon
from hydrabeam_mpi.model.engine import make_engine
from hydrabeam_mpi.model.positions import ApparentPositions
from hydrabeam_mpi.model.rime import ForwardModel
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.run import simulate
from hydrabeam_mpi.tables import embedded_beam

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:pyuvsim", "ignore::UserWarning:pyuvdata")

LOCATION = EarthLocation.from_geodetic(lon=21.4283, lat=-30.7215, height=1051.69)
FREQS = np.array([110e6, 131e6])
HOURS = np.array([0.0, 0.7, 3.1, 5.0, 8.2])
# Metres. No symmetry, and heights that matter: 3 m are 8 rad of phase near the zenith. The hexagon is a lattice,
# for which engine and fftvis have code of their own.
ARRAYS = {
    "irregular": np.array(
        [[0.1, -0.2, 0.0], [14.6, 0.4, -0.9], [7.3, 12.7, 0.6], [-11.3, 17.9, 1.7], [23.4, -15.1, -1.3]]
    ),
    "hexagon": hexagon(2, 3, 14.6).antpos,
}


def lopsided(za, az):
    """A beam that no mirror and no quarter turn leaves as it is, and that is large at the horizon."""
    east, north = np.sin(za) * np.cos(az), np.sin(za) * np.sin(az)
    return np.exp(-0.5 * ((east - 0.1) / 0.6) ** 2 - 0.5 * ((north + 0.2) / 0.4) ** 2)


@dataclass(kw_only=True, eq=False)
class Lopsided(AnalyticBeam):
    """The same beam as pyuvdata has it, for feed x; the E-field is shared by both of its components."""

    def _efield_eval(self, *, az_grid, za_grid, f_grid):
        field = self._get_empty_data_array(az_grid.shape)
        field[:] = np.sqrt(0.5 * lopsided(za_grid, az_grid))
        return field


def observe(antpos, step=-5):
    """Lay out antennas, whose numbers need not ascend, in all pairs, every other one reversed."""
    numbers = 30 + step * np.arange(len(antpos))
    one, two = np.triu_indices(len(antpos), 1)
    one[::2], two[::2] = two[::2].copy(), one[::2].copy()
    times = 2459866.3 + HOURS / 24
    return Observation(
        telescope_name="made",
        location=LOCATION,
        antenna_numbers=numbers,
        antenna_names=tuple(f"A{number}" for number in numbers),
        antpos=antpos,
        antpairs=np.stack([numbers[one], numbers[two]], axis=1),
        freqs=FREQS,
        channel_width=np.full(2, 1e5),
        times=times,
        lsts=Time(times, format="jd", location=LOCATION).sidereal_time("apparent").rad,
        integration_time=np.full(len(times), 10.0),
        pols=("ee",),
    )


def draw_sky(n=300):
    rng = np.random.default_rng(1)
    flux = 10 ** rng.uniform(-1, 2, n)
    return Sky(
        rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(-1, 1, n)), np.stack([flux, flux * rng.uniform(0.2, 1, n)])
    )


SKY = draw_sky()


def ours(observation, sky=SKY, beam=lopsided, engine="gemm"):
    model = ForwardModel(
        ApparentPositions(sky, observation), sky.flux, observation.freqs, make_engine(engine, observation.bl_vectors, 1e-7)
    )
    return model.visibilities([beam] * observation.Nfreqs, np.arange(observation.Ntimes))


def positions_by_number(observation):
    return dict(zip(observation.antenna_numbers.tolist(), observation.antpos, strict=True))


def by_matvis(observation, sky=SKY, beam=None, **options):
    antennas = positions_by_number(observation)
    order = list(antennas)
    return matvis.simulate_vis(
        ants=antennas,
        fluxes=sky.flux.T,
        ra=sky.ra,
        dec=sky.dec,
        freqs=observation.freqs,
        times=Time(observation.times, format="jd"),
        beams=[beam or Lopsided()],
        telescope_loc=observation.location,
        precision=2,
        antpairs=np.array([[order.index(ant) for ant in pair] for pair in observation.antpairs.tolist()]),
        coord_method="CoordinateRotationAstropy",
        **options,
    )


def by_fftvis(observation, sky=SKY, beam=None, **options):
    return fftvis.simulate_vis(
        ants=positions_by_number(observation),
        fluxes=sky.flux.T,
        ra=sky.ra,
        dec=sky.dec,
        freqs=observation.freqs,
        times=Time(observation.times, format="jd"),
        beam=beam or Lopsided(),
        telescope_loc=observation.location,
        precision=2,
        baselines=[tuple(pair) for pair in observation.antpairs.tolist()],
        coord_method="CoordinateRotationAstropy",
        **options,
    )


def by_pyuvsim(path, sky, beam):
    """Simulate what the metadata of a file say, and return the simulated and the file's data, as pyuvdata reads them."""
    pyuvsim = pytest.importorskip("pyuvsim")
    written = UVData.from_file(path)
    n_freqs = sky.Nfreqs
    model = SkyModel(
        name=[f"source {number}" for number in range(sky.Nsrc)],
        skycoord=SkyCoord(sky.ra * units.rad, sky.dec * units.rad, frame="icrs"),
        stokes=np.stack([sky.flux, *np.zeros((3, n_freqs, sky.Nsrc))]) * units.Jy,
        spectral_type="full",
        freq_array=written.freq_array * units.Hz,
    )
    beam_of = dict.fromkeys(written.telescope.antenna_names, 0)
    simulated = pyuvsim.uvsim.run_uvdata_uvsim(
        written.copy(), pyuvsim.BeamList([beam]), beam_of, model, quiet=True
    )
    pairs = written.get_antpairs()
    return [np.array([uv.get_data(*pair, "ee") for pair in pairs]) for uv in (simulated, written)]


FEED = {"feed_array": np.array(["x"]), "feed_angle": np.array([np.pi / 2]), "mount_type": "fixed"}
SIMULATORS = {"matvis": by_matvis, "fftvis": by_fftvis}


@cache
def simulated(array, simulator):
    return SIMULATORS[simulator](observe(ARRAYS[array]))


def difference(one, other):
    """Largest difference in units of the largest visibility."""
    assert one.shape == other.shape
    return np.abs(one - other).max() / np.abs(other).max()


def as_ours(visibilities, simulator):
    """fftvis already returns (Nfreqs, Ntimes, Nbls), like matvis."""
    return visibilities
