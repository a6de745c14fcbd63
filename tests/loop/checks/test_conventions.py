"""Wrong conventions are named, each by its own name; other errors and good data are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from mpi4py import MPI
from pyuvdata import UVData

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.fit.rows import read_rows
from hydrabeam_mpi.inference.robust import STRONG
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.io.uvfile import enu_axes
from hydrabeam_mpi.loop.checks.conventions import Score, check_conventions, factor_log_odds, sample_times
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.problem import Problem, prepare
from hydrabeam_mpi.simulation.mock import simulate_to

NUMBERS = (12, 3, 7, 1, 20, 9, 15, 4)
COMMON = """
seed = 4
[holdout]
every = 2
[sky]
n_sources = 120
positions = "{positions}"
[beam]
frequency = "scale"
[basis]
n_modes = 40
k_max = 8
m_max = 3
"""
SIMULATE = """
[data.simulate]
array = {{ file = "layout.csv" }}
n_times = 24
freqs = ["131 MHz", "135 MHz"]
nsamples = 10
perturb = {perturb}
"""
PERFECT = "{ stretch = [1.0, 1.0], sidelobe = 0.0 }"
PERTURBED = "{ stretch = [1.01, 1.02], sidelobe = 0.2 }"


def simulated(folder: Path, positions: str = "lst", perturb: str = PERFECT) -> Job:
    """Simulate ``data.uvh5`` and return a job that reads it."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(8)
    places = np.column_stack([rng.uniform(-90, 90, 8), rng.uniform(-60, 60, 8), rng.uniform(-0.3, 0.3, 8)])
    lines = [f"{n},A{n},{e!r},{north!r},{u!r}" for n, (e, north, u) in zip(NUMBERS, places.tolist(), strict=True)]
    (folder / "layout.csv").write_text("\n".join(["number,name,E,N,U", *lines]))
    common = COMMON.format(positions=positions)
    (folder / "simulate.toml").write_text(common + SIMULATE.format(perturb=perturb))
    simulate_to(MPI.COMM_SELF, load_job(folder / "simulate.toml"), folder)
    (folder / "read.toml").write_text(common + '[data]\nfiles = ["data.uvh5"]\n')
    return load_job(folder / "read.toml")


def problem_of(job: Job, damage: Callable[[UVData], None] | None = None) -> Problem:
    """Set up the problem of the job's file, or of a damaged copy."""
    path = Path(job.data.files[0])
    if damage is not None:
        with quiet():
            uv = UVData.from_file(path)
            damage(uv)
            path = path.with_name("damaged.uvh5")
            uv.write_uvh5(path, clobber=True, run_check=False)
    return prepare(job, (path,))


def check(problem: Problem, world: MPI.Comm = MPI.COMM_SELF) -> dict:
    grid = ProcessGrid.split(world, problem.observation.Nfreqs)
    mine = problem.of_channels(grid.channels)
    return check_conventions(grid, mine, read_rows(mine, mine.tile_of(mine.train, grid.group.rank, grid.group.size)))


@pytest.fixture(scope="module")
def job(tmp_path_factory) -> Job:
    return simulated(tmp_path_factory.mktemp("good"))


def test_good_data(job: Job) -> None:
    found = check(problem_of(job))
    assert found["found"] is None
    assert found["remedy"] is None
    stated = found["tested"][0]
    assert stated["name"] == "as stated"
    assert stated["chi2"] == pytest.approx(1, abs=0.15)
    assert stated["amplitude"] == pytest.approx(1, abs=0.01)
    assert stated["explained"] > 0.99
    assert len({one["name"] for one in found["tested"]}) == len(found["tested"]) > 15


def moved(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[UVData], None]:
    """Change the positions that a file states, (Nants, 3) metres ENU in the file's order."""

    def damage(uv: UVData) -> None:
        axes = enu_axes(uv.telescope.location)
        uv.telescope.antenna_positions = change(uv.telescope.antenna_positions @ axes.T) @ axes

    return damage


def late(seconds: float) -> Callable[[UVData], None]:
    """Change the times that a file states."""

    def damage(uv: UVData) -> None:
        uv.time_array = uv.time_array + seconds / 86400
        uv.set_lsts_from_time_array()

    return damage


def conjugated(uv: UVData) -> None:
    uv.data_array = uv.data_array.conj()


def exchanged(uv: UVData) -> None:
    uv.ant_1_array, uv.ant_2_array = uv.ant_2_array, uv.ant_1_array


def scaled(factor: float) -> Callable[[UVData], None]:
    def damage(uv: UVData) -> None:
        cross = uv.ant_1_array != uv.ant_2_array
        uv.data_array[cross] *= factor

    return damage


BY_NUMBER = np.argsort(NUMBERS)
BY_NAME = np.argsort([f"A{number}" for number in NUMBERS])
DAMAGES = {
    "conjugated": conjugated,
    "factor 2": scaled(2.0),
    "factor 1/2": scaled(0.5),
    "north and east swapped": moved(lambda enu: enu[:, [1, 0, 2]]),
    "east mirrored": moved(lambda enu: enu * [-1, 1, 1]),
    "north mirrored": moved(lambda enu: enu * [1, -1, 1]),
    "antenna order reversed": moved(lambda enu: enu[::-1]),
    "positions sorted by number, antennas not": moved(lambda enu: enu[BY_NUMBER]),
    "antennas sorted by number, positions not": moved(lambda enu: enu[np.argsort(BY_NUMBER)]),
    "positions sorted by name, antennas not": moved(lambda enu: enu[BY_NAME]),
    "antennas sorted by name, positions not": moved(lambda enu: enu[np.argsort(BY_NAME)]),
    "times in TAI": late(37),
    "times early by TAI - UTC": late(-37),
    "times in TT": late(69.184),
    "times early by TT - UTC": late(-69.184),
    "times of the integrations' starts": late(-5),
    "times of the integrations' ends": late(5),
    "times early by half a day": late(-43200),
    "times late by half a day": late(43200),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_named(job: Job, name: str) -> None:
    found = check(problem_of(job, DAMAGES[name]))
    assert found["found"] == name
    assert found["remedy"]


def test_exchanged_antennas_conjugate(job: Job) -> None:
    assert check(problem_of(job, exchanged))["found"] == "conjugated"


def test_turned_beam(job: Job) -> None:
    problem = problem_of(job)
    beams = tuple(lambda za, az, beam=beam: beam(za, (az - np.pi / 2) % (2 * np.pi)) for beam in problem.beams)
    assert check(replace(problem, beams=beams))["found"] == "polarisation swapped"


@pytest.mark.parametrize("name", ["conjugated", "north and east swapped", "times in TT", "factor 1/2"])
def test_through_a_wrong_beam(tmp_path: Path, name: str) -> None:
    assert check(problem_of(simulated(tmp_path, perturb=PERTURBED), DAMAGES[name]))["found"] == name


@pytest.mark.parametrize("name", ["times in TAI", "times early by half a day"])
def test_apparent_places(tmp_path: Path, name: str) -> None:
    assert check(problem_of(simulated(tmp_path, positions="apparent"), DAMAGES[name]))["found"] == name


NAMES_OF_PLACES = "places of B1950", "places of J2000, read as B1950"


@pytest.mark.parametrize("name", NAMES_OF_PLACES)
def test_places_of_another_equinox(tmp_path: Path, name: str) -> None:
    """What a catalogue states is what stands in the other frame, which astropy knows, of where the sources are."""
    problem = problem_of(simulated(tmp_path, positions="apparent"))
    places = SkyCoord(problem.sky.ra, problem.sky.dec, unit="rad")
    stated = places.fk4 if name == NAMES_OF_PLACES[0] else SkyCoord(*_radians(places), unit="rad", frame="fk4").icrs
    ra, dec = _radians(stated)
    found = check(replace(problem, sky=replace(problem.sky, ra=ra, dec=dec)))
    assert found["found"] == name
    assert "catalogue" in found["remedy"]


def _radians(places: SkyCoord) -> tuple[np.ndarray, np.ndarray]:
    return places.ra.rad, places.dec.rad


@pytest.mark.parametrize(
    ("positions", "read_as", "name"),
    [("lst", "apparent", "sky turned by sidereal time alone"), ("apparent", "lst", "apparent places")],
)
def test_how_the_sky_turns(tmp_path: Path, positions: str, read_as: Literal["apparent", "lst"], name: str) -> None:
    job = simulated(tmp_path, positions=positions)
    job = job.model_copy(update={"sky": job.sky.model_copy(update={"positions": read_as})})
    found = check(problem_of(job))
    assert found["found"] == name
    assert f"positions = '{positions}'" in found["remedy"]


def gains(uv: UVData) -> None:
    rng = np.random.default_rng(1)
    gain = np.exp(0.05 * (rng.normal(size=100) + 1j * rng.normal(size=100)))
    uv.data_array *= (gain[uv.ant_1_array] * gain[uv.ant_2_array].conj())[:, None, None]


@pytest.mark.parametrize(
    "damage",
    [gains, late(30), late(-50), late(6), late(2), late(80), scaled(1.2), scaled(1.7)],
    ids=["gains", "30 s", "-50 s", "6 s", "2 s", "80 s", "1.2", "1.7"],
)
def test_other_errors_are_left_to_effects(job: Job, damage: Callable[[UVData], None]) -> None:
    assert check(problem_of(job, damage))["found"] is None


def half(amplitude: float, left: float, model: float = 1e6) -> float:
    """Tell how surely data are halved that are so many times the model but for a part of their amplitude."""
    power = amplitude**2 * model
    score = Score(n=1000.0, data=power / (1 - left**2) + 1000.0, overlap=amplitude * model, model=model)
    beside_none, beside_any = factor_log_odds(score, 0.5)
    return min(beside_none - STRONG, beside_any)


def test_how_near_a_factor_must_be_depends_on_how_well_the_model_follows_the_data() -> None:
    assert half(0.5, 0.0) > half(0.53, 0.0) > 0 > half(0.62, 0.0)
    assert half(0.58, 0.0) < 0 < half(0.58, 0.1)
    # A sky that lacks so much, or a beam as wrong, may be half of the data as well.
    assert half(0.5, 0.5) < 0
    # Nor do data tell it in which there is hardly any signal.
    assert half(0.5, 0.0, model=10.0) < 0
    assert factor_log_odds(Score(10.0, 20.0, -5.0, 10.0), 0.5) == (-np.inf, -np.inf)


def test_a_wrong_beam_is_no_convention(tmp_path: Path) -> None:
    found = check(problem_of(simulated(tmp_path, perturb=PERTURBED)))
    assert found["found"] is None
    assert found["tested"][0]["chi2"] > 2


def test_data_of_noise_say_nothing(job: Job) -> None:
    def noise(uv: UVData) -> None:
        rng = np.random.default_rng(2)
        cross = uv.ant_1_array != uv.ant_2_array
        shape = uv.data_array[cross].shape
        uv.data_array[cross] = 0.1 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))

    assert check(problem_of(job, noise))["found"] is None


def test_equal_layouts_are_left_out(tmp_path: Path) -> None:
    """On a line from East to West nothing tells north, and east mirrored conjugates."""
    job = simulated(tmp_path)
    line = problem_of(job, moved(lambda enu: enu * [1, 0, 0]))
    names = [one["name"] for one in check(line)["tested"]]
    assert "conjugated" in names
    assert not {"north mirrored", "east mirrored"} & set(names)


def test_sampled_times() -> None:
    np.testing.assert_array_equal(sample_times(np.array([3, 5, 9])), [3, 5, 9])
    chosen = sample_times(np.arange(0, 100, 2))
    assert len(chosen) == 8
    assert (chosen[0], chosen[-1]) == (0, 98)


@pytest.mark.mpi
def test_any_number_of_ranks(comm: MPI.Comm, common_tmp_path: Path) -> None:
    job = None
    if comm.rank == 0:
        job = simulated(common_tmp_path)
        problem_of(job, DAMAGES["times in TAI"])
    job = comm.bcast(job)
    problem = prepare(job, (common_tmp_path / "damaged.uvh5",))
    alone, shared = check(problem), check(problem, comm)
    assert shared["found"] == alone["found"] == "times in TAI"
    for one, two in zip(alone["tested"], shared["tested"], strict=True):
        assert one["name"] == two["name"]
        # chi^2 is what is left of a power a million times larger.
        assert one["chi2"] == pytest.approx(two["chi2"], rel=1e-7)
