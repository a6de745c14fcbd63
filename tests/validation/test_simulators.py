"""The forward model against simulators that share no code with it: matvis, fftvis and pyuvsim.

All three follow the sources with astropy, have the factor 1/2, and drop what is below the horizon, so that nothing
but rounding is left. The differences found are 4e-14 of the largest visibility (GEMM engine) and 2e-12 (NUFFT
engine, which is asked for 1e-12); through a file, whose antenna positions are relative to the Earth's centre, 4e-10.
"""

import sys
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import ClassVar

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

from hydrabeam_mpi.commands.simulate import simulate
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.data.observation import C_M_PER_S, Observation
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.sky.polarised_sources import PolarisedSources
from hydrabeam_mpi.io.beamfits import write_power_beam
from hydrabeam_mpi.io.uvwrite import write_uvh5
from hydrabeam_mpi.model.engines import make_engine
from hydrabeam_mpi.model.engines.smearing import smearing_of
from hydrabeam_mpi.model.positions import ApparentPositions
from hydrabeam_mpi.model.rime import ForwardModel
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.simulation.arrays import hexagon
from hydrabeam_mpi.tables import embedded_beam
from tests.effects.small import small_setup

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

    basis_vector_type: ClassVar[str] = "az_za"

    def _efield_eval(self, *, az_grid, za_grid, f_grid):
        field = self._get_empty_data_array(az_grid.shape)
        field[:] = np.sqrt(0.5 * lopsided(za_grid, az_grid))
        return field


@dataclass(kw_only=True, eq=False)
class Dipole(AnalyticBeam):
    """A short dipole along its feed's direction, as pyuvsim sees it.

    pyuvdata's own takes no feed alone but the one towards North. pyuvsim takes the field's first component for that
    towards azimuths that grow from North through East, as the coherencies of pyradiosky are, and not from East through
    North as pyuvdata's: else a dipole would not see the same polarisation on all sides of the zenith.
    """

    basis_vector_type: ClassVar[str] = "az_za"

    def _efield_eval(self, *, az_grid, za_grid, f_grid):
        field = self._get_empty_data_array(az_grid.shape)
        along = az_grid + self.feed_angle[0] - np.pi / 2  # from the feed's own direction
        field[0, 0], field[1, 0] = np.sin(along), np.cos(za_grid) * np.cos(along)
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
        ApparentPositions(sky, observation),
        sky.flux,
        observation.freqs,
        make_engine(engine, observation.bl_vectors, smearing=smearing_of(observation)),
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
        nthreads=1,
        coord_method="CoordinateRotationAstropy",
        **options,
    )


def by_pyuvsim(path, sky, beam, polarised=None):
    """Simulate what the metadata of a file say; return these data and those of the file, (Nbls, Ntimes, Nfreqs).

    ``polarised``, (2, Nfreqs, Nsrc), are Stokes Q and U; none by default.
    """
    pyuvsim = pytest.importorskip("pyuvsim")
    written = UVData.from_file(path)
    none = np.zeros((2, sky.Nfreqs, sky.Nsrc))
    model = SkyModel(
        name=[f"source {number}" for number in range(sky.Nsrc)],
        skycoord=SkyCoord(sky.ra * units.rad, sky.dec * units.rad, frame="icrs"),
        stokes=np.stack([sky.flux, *(none if polarised is None else polarised), none[0]]) * units.Jy,
        spectral_type="full",
        freq_array=written.freq_array * units.Hz,
    )
    beam_of = dict.fromkeys(written.telescope.antenna_names, 0)
    simulated = pyuvsim.uvsim.run_uvdata_uvsim(written.copy(), pyuvsim.BeamList([beam]), beam_of, model, quiet=True)
    pairs = written.get_antpairs()
    return [np.array([uv.get_data(*pair, uv.get_pols()[0]) for pair in pairs]) for uv in (simulated, written)]


FEED = {"feed_array": np.array(["x"]), "feed_angle": np.array([np.pi / 2]), "mount_type": "fixed"}
SIMULATORS = {"matvis": by_matvis, "fftvis": by_fftvis}


@cache
def simulated(array, simulator):
    return SIMULATORS[simulator](observe(ARRAYS[array]))


def difference(one, other):
    """Largest difference in units of the largest visibility."""
    assert one.shape == other.shape
    return np.abs(one - other).max() / np.abs(other).max()


def test_sources_rise_and_set():
    """What the other tests rely on: the set of sources above the horizon changes from time to time."""
    above = ApparentPositions(SKY, observe(ARRAYS["irregular"])).above_horizon
    sets = [set(above(time)[0].tolist()) for time in range(len(HOURS))]
    for before, after in pairwise(sets):
        assert len(before - after) > 2
        assert len(after - before) > 2


@pytest.mark.parametrize("simulator", SIMULATORS)
@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize(("engine", "tolerance"), [("gemm", 1e-12), ("nufft", 2e-11)])
def test_visibilities(array, simulator, engine, tolerance):
    assert difference(ours(observe(ARRAYS[array]), engine=engine), simulated(array, simulator)) < tolerance


MISTAKES = {
    "conjugated": (lambda antpos: -antpos, lopsided),
    "North and East exchanged in the array": (lambda antpos: antpos[:, [1, 0, 2]], lopsided),
    "heights upside down": (lambda antpos: antpos * [1, 1, -1], lopsided),
    "North and East exchanged in the beam": (np.copy, lambda za, az: lopsided(za, np.pi / 2 - az)),
    "azimuth from North through East": (np.copy, lambda za, az: lopsided(za, az - np.pi / 2)),
    "azimuth the other way": (np.copy, lambda za, az: lopsided(za, -az)),
    "beam turned by half a turn": (np.copy, lambda za, az: lopsided(za, az + np.pi)),
    "beam of the field, not of the power": (np.copy, lambda za, az: np.sqrt(lopsided(za, az))),
    "no factor of a half": (np.copy, lambda za, az: 2 * lopsided(za, az)),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_would_be_seen(mistake):
    change, beam = MISTAKES[mistake]
    observation = observe(ARRAYS["irregular"])
    wrong = ours(replace(observation, antpos=change(observation.antpos)), beam=beam)
    assert difference(wrong, simulated("irregular", "matvis")) > 0.1


@pytest.mark.parametrize("array", ARRAYS)
def test_means_over_integrations_and_channels(array):
    """Those of a minute and a megahertz on baselines ten times as long, against matvis at instants and frequencies."""
    observation = observe(10 * ARRAYS[array])
    near = ApparentPositions(SKY, observation).above_horizon
    index, za, _ = near(0)
    high = index[za < np.deg2rad(80)]
    sky = Sky(SKY.ra[high], SKY.dec[high], SKY.flux[:, high])
    # All are above the horizon at all the instants.
    observation = replace(
        observation,
        times=observation.times[:1],
        lsts=observation.lsts[:1],
        integration_time=np.full(1, 60.0),
        channel_width=np.full(2, 1e6),
    )
    steps, weights = np.polynomial.legendre.leggauss(4)
    mean = 0.0
    for step, of_time in zip(steps, weights, strict=True):
        days = 0.5 * step * 60.0 / 86400
        for shift, of_freq in zip(steps, weights, strict=True):
            instant = replace(observation, times=observation.times + days, freqs=observation.freqs + 0.5 * shift * 1e6)
            mean = mean + 0.25 * of_time * of_freq * by_matvis(instant, sky)
    lost = difference(ours(observation, sky), mean)
    assert lost > 0.05
    assert difference(ours(replace(observation, is_smeared=True), sky), mean) < 0.005 * lost


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_a_source_of_ten_jansky_in_a_beam_of_one_is_five_jansky(simulator):
    """The factor 1/2: the co-polarised visibility of an unpolarised source is half of its Stokes I, here as there."""
    observation = observe(ARRAYS["irregular"])
    sky = Sky(observation.lsts[:1], np.array([observation.location.lat.rad]), np.full((2, 1), 10.0))
    mine = ours(observation, sky, lambda za, az: np.ones_like(za))[:, 0]
    theirs = SIMULATORS[simulator](observation, sky, UniformBeam())[:, 0]
    np.testing.assert_allclose(np.abs(mine), 5.0, rtol=1e-12)
    np.testing.assert_allclose(theirs, mine, rtol=1e-10)


@pytest.fixture(scope="module")
def vivaldi_file(tmp_path_factory):
    """The built-in beam on a quarter-degree grid, as a beamfits file."""
    za, az = np.meshgrid(np.deg2rad(np.arange(361) / 4), np.deg2rad(np.arange(1440) / 4), indexing="ij")
    values = embedded_beam()(za.ravel(), az.ravel()).reshape(za.shape)
    path = tmp_path_factory.mktemp("beam") / "vivaldi.beamfits"
    write_power_beam(path, np.broadcast_to(values, (1, 2, *values.shape)), FREQS, ["ee"], telescope_name="made")
    return path


def test_a_beam_file_is_the_same_beam_to_all(vivaldi_file):
    """The file's samples are interpolated by pyuvdata for both sides, with the function that the simulator uses."""
    observation = observe(ARRAYS["irregular"])
    for simulator, function in (("matvis", "az_za_map_coordinates"), ("fftvis", "az_za_simple")):
        uvbeam = UVBeam.from_file(vivaldi_file)

        def interpolated(za, az, uvbeam=uvbeam, function=function):
            options = {"freq_array": FREQS[:1], "interpolation_function": function, "return_basis_vector": False}
            return uvbeam.interp(az_array=az, za_array=za, **options)[0][0, 0, 0]

        options = {"interpolation_function": function} if simulator == "fftvis" else {}
        theirs = SIMULATORS[simulator](observation, beam=UVBeam.from_file(vivaldi_file), **options)
        assert difference(ours(observation, beam=interpolated), theirs) < 1e-12
        if function == "az_za_simple":
            # The coefficients themselves, against splines between samples a quarter of a degree apart.
            assert difference(ours(observation, beam=embedded_beam()), theirs) < 1e-6


def test_a_written_file_is_what_pyuvsim_makes_of_its_metadata(tmp_path, monkeypatch):
    """Antenna positions, times, baseline order and polarisation as pyuvdata understands them."""
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)  # pyuvsim sets one that ends the process
    # pyuvsim takes antennas in the order of the file to be in the order of their numbers.
    observation = observe(ARRAYS["irregular"], step=5)
    data = ours(observation)[..., np.newaxis]
    path = tmp_path / "data.uvh5"
    write_uvh5(path, observation, data, np.zeros(data.shape, bool), np.ones(data.shape))
    theirs, read_back = by_pyuvsim(path, SKY, Lopsided(**FEED))
    np.testing.assert_array_equal(read_back, data[..., 0].transpose(2, 1, 0))
    assert difference(read_back, theirs) < 1e-8


@pytest.mark.parametrize(("pol", "feed", "angle"), [("ee", "x", np.pi / 2), ("nn", "y", 0.0)])
def test_polarised_sources_against_pyuvsim(tmp_path, monkeypatch, pol, feed, angle):
    """Short dipoles either way: only the poles of catalogue and date differ, by less than ten arcmin."""
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    observation, sky = replace(observe(ARRAYS["irregular"], step=5), pols=(pol,)), draw_sky(40)
    fraction, rotation, which = 0.3 * np.exp(2j * np.arange(8)), np.linspace(-4, 4, 8), np.arange(0, 40, 5)
    squares = (C_M_PER_S / FREQS[:, np.newaxis]) ** 2
    polarised = np.zeros((2, *sky.flux.shape))
    turned = fraction * np.exp(2j * rotation * (squares - (C_M_PER_S / 140e6) ** 2)) * sky.flux[:, which]
    polarised[..., which] = turned.real, turned.imag

    setup = replace(small_setup(), observation=observation, sky=sky)
    effect = PolarisedSources(np.rad2deg([sky.ra, sky.dec]).T[which], 1, rotation, freq=140e6)
    x = np.stack([fraction.real, fraction.imag, np.zeros(8)], axis=1).ravel()

    def dipole(za, az):
        return 1 - (np.sin(za) * np.sin(az + angle)) ** 2

    vis, without = [], ours(observation, sky, dipole)
    for itime in range(observation.Ntimes):
        index, za, az = ApparentPositions(sky, observation).above_horizon(itime)
        flux = sky.flux.copy()
        for channel, freq in enumerate(FREQS):
            sources = Sources(index, za, az, sky.flux[channel, index], dipole, freq=freq, itime=itime)
            flux[channel, index] *= effect.sky_factor(setup, sources, x)
        vis.append(ours(observation, replace(sky, flux=flux), dipole)[:, itime])
    data = np.stack(vis, axis=1)[..., np.newaxis]
    path = tmp_path / "data.uvh5"
    write_uvh5(path, observation, data, np.zeros(data.shape, bool), np.ones(data.shape))
    beam = Dipole(feed_array=np.array([feed]), feed_angle=np.array([angle]), mount_type="fixed")
    theirs, read_back = by_pyuvsim(path, sky, beam, polarised)
    assert np.abs(read_back - theirs).max() < 5e-3 * np.abs(data[..., 0] - without).max()
    assert np.abs(data[..., 0] - without).max() > 0.02 * np.abs(data).max()


JOB = """
[data.simulate]
array = {{ file = "{array}" }}
lst_range = ["6 h", "12 h"]
n_times = 4
freqs = ["110 MHz", "131 MHz"]
noise = false
perturb = {{ stretch = [1, 1], sidelobe = 0 }}
[sky]
n_sources = 300
positions = "apparent"
[beam]
source = "airy"
diameter = "9 m"
"""


def test_the_simulate_command_against_pyuvsim(tmp_path, monkeypatch):
    """Cross- and autocorrelations of `hydrabeam simulate`, from nothing but the two files that it writes."""
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    np.savetxt(tmp_path / "array.txt", ARRAYS["irregular"])
    (tmp_path / "job.toml").write_text(JOB.format(array=tmp_path / "array.txt"))
    job = tmp_path / "job.toml"
    simulate(MPI.COMM_SELF, load_job(job), job, tmp_path / "out", overwrite=False, threads=1)
    with h5py.File(tmp_path / "out" / "truth.h5") as truth:
        sky = Sky(truth["ra"][:], truth["dec"][:], truth["flux"][:])
    theirs, ours_in_file = by_pyuvsim(tmp_path / "out" / "data.uvh5", sky, AiryBeam(diameter=9.0, **FEED))
    assert len(theirs) == 15  # 10 cross-correlations and 5 autocorrelations
    assert difference(ours_in_file, theirs) < 1e-8
