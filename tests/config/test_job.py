from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest
import tomli_w
from pydantic import BaseModel, ValidationError

from hydrabeam_mpi.config import Job, Section, load_job
from hydrabeam_mpi.config.effects import Effect, Injected
from hydrabeam_mpi.config.sample import SampledEffect

JOBS = sorted((Path(__file__).parents[2] / "jobs").glob("*/*.toml"))

# Between these two, no key that they give at its default.
FILES = """
name = "all of it"
seed = 7

[data]
files = ["night*.uvh5", "/elsewhere/night.uvh5"]
polarization = "nn"
pol_convention = "avg"
gains = ["gains.calfits"]
antennas = [1, 2, 3]
exclude_antennas = [4]
antpairs = [[1, 2], [2, 3]]
exclude_baselines = [[1, 3]]
exclude_times = [[2459866.3, 2459866.31]]
flux_scale = 6700.0
lst_range = ["23 h", "30 deg"]
time_range = [2459866.25, 2459867.5]
every_time = 2
freq_range = ["100 MHz", "200 MHz"]
freqs = ["131.25 MHz", "129.6875 MHz"]
channels = [3, 1]
channel_width = "97.65625 kHz"
min_bl_length = "10 m"
max_bl_length = "100 m"
redundancy_tol = "5 cm"
smearing = true

[noise]
kind = "constant"
sigma = "250 mJy"

[holdout]
kind = "lst"
lst_ranges = [["1 h", "2 h"], ["3 h", "4 h"]]

[sky]
kind = "catalogue"
reference_freq = "180 MHz"
file = "sky/gleam.vot"
diffuse = "../gsm"
positions = "lst"
flux_min = "1 Jy"
model_flux_min = "2 Jy"

[sky.columns]
table = "t"
name = "n"
lon = "l"
lat = "b"
frame = "galactic"
flux = ["a", "b"]
freqs = ["100 MHz", "200 MHz"]

[beam]
source = "beam.fits"
east_feed = "y"
frequency = "scale"

[basis]
kind = "zernike"
edge = "95 deg"
max_degree = 9

[prior]
kind = "file"
file = "prior.h5"

[solver]
engine = "nufft"
compress = false

[output]
draws = 0

[loop]
effects = ["antenna_gains", "diffuse", "noise_level"]
skip = ["diffuse"]
max_rounds = 0
min_log_bayes_factor = 12.5

[sample]
blocks = ["beam", "noise", "prior_width", "catalogue_flux", "antenna_gains"]
chains = 2
draws = 50
warm_up = 0
thin = 3
collapsed = false
heldout = false
positive_beam = 4
noise_prior = [2, 0.5]
noise_groups = "antenna"
noise_dof = 4.0
width_prior = [3, 4.5]
width_groups = "radial"

[[sample.effects]]
kind = "catalogue_flux"
foremost = 10
width = 0.5
draw_widths = true

[[sample.effects]]
kind = "antenna_gains"
settings = { law = "smooth" }
prior_std = { "antenna 1 ln amplitude" = 0.5 }

[[effects]]
kind = "missing_sources"
settings = { ra_deg = [30.5], dec_deg = [-30.0], n_candidates = 1 }
names = ["flux", "east"]
index = [0, 2]
values = [[0.25, -1e-3], [0.5, -1e-3]]
std = [[0.01, 1e-5], [0.01, 1e-5]]
prior_std = [0.5, 0.01]

[[effects]]
kind = "noise_level"
values = [[1.25], [1.5]]
std = [[0.1], [0.1]]
"""
SIMULATION = """
[data.simulate]
latitude = "0.1 rad"
longitude = -100
height = "1 km"
start = 2460000.5
lst_range = ["20 h", "2 h"]
n_times = 3
nights = 2
freqs = ["130 MHz", 131e6]
channel_width = "1 MHz"
integration_time = "1 min"
nsamples = 2.5
noise = false
array = { file = "layout.csv" }
perturb = { stretch = [1, 1.5], sidelobe = 0 }

[[data.simulate.effects]]
kind = "antenna_gains"
settings = { of = "one" }
parameters = { "antenna 3 amplitude" = 0.04 }

[[data.simulate.effects]]
kind = "antenna_delays"
strength = 0.5

[holdout]
every = 3

[sky]
n_sources = 3
flux_range = ["10 mJy", "1 Jy"]
spectral_index = -0.8

[beam]
source = "airy"
diameter = "14 m"

[basis]
form = "complex"
n_modes = 12
k_max = 7
m_max = 6
rest = true
boundary = "dirichlet"

[prior]
fraction = 0.5
floor = 1e-5
neighbours = true
azimuthal = [0.5, 2.0]
smooth = { amplitude = 1e-3, decay = [0.1, 0.5] }
widths = "evidence"
shape = false

[solver]
precision = "mixed"
"""
# What the others cannot have, as other keys would then be in vain.
OTHERS = [
    "[data.simulate.array]\nhex = [2, 3]\nspacing = '10 m'",
    "[data]\nfiles = ['a']\n[noise]\nkind = 'file'\nfile = 'noise.npz'",
    "[data]\nfiles = ['a']\n[holdout]\nkind = 'jd'\njd_ranges = [[2459866, 2459867]]",
    "[data]\nfiles = ['a']\n[holdout]\nkind = 'baselines'\nantpairs = [[1, 2]]",
    "[data]\nfiles = ['a']\n[sky]\nkind = 'catalogue'\nfile = 'a.vot'\n[sky.columns]\nreference_freq = '150 MHz'\n"
    "spectral_index = ''",
    "[data]\nfiles = ['a']\n[prior.frequency]\nkind = 'modes'\nmodes = 'dpss'\nn_modes = 3\ndelay = '100 ns'",
    "[data]\nfiles = ['a']\n[prior.frequency]\nkind = 'gaussian-process'\nkernel = 'matern-3/2'\n"
    "length = ['5 MHz', 1e7]\nevidence = 'marginalise'\nsolver = 'dense'",
]


def write(text: str, folder: Path) -> Path:
    (folder / "job.toml").write_text(text)
    return folder / "job.toml"


def sections(model: type[BaseModel] = Job) -> Iterator[type[BaseModel]]:
    yield model
    for field in model.model_fields.values():
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, Section):
                yield from sections(kind)


@pytest.mark.parametrize("text", [FILES, SIMULATION, *OTHERS, "[data.simulate]", "[data]\nfiles = ['a']"])
def test_resolved_job_is_the_same_job(text: str, tmp_path: Path) -> None:
    job = load_job(write(text, tmp_path))
    elsewhere = tmp_path / "result"
    elsewhere.mkdir()
    resolved = tomli_w.dumps(job.model_dump(mode="json", exclude_none=True))
    assert load_job(write(resolved, elsewhere)) == job


def parts(section: Section) -> Iterator[Section]:
    """Yield a table and all within it."""
    yield section
    for name in type(section).model_fields:
        value = getattr(section, name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, Section):
                yield from parts(item)


def test_every_key_is_other_than_its_default_in_one_of_these_jobs(tmp_path: Path) -> None:
    """So that the test above, of which they are the material, leaves nothing out."""
    told: dict[type[BaseModel], set[str]] = {}
    for text in (FILES, SIMULATION, *OTHERS):
        for part in parts(load_job(write(text, tmp_path))):
            other = {name for name, field in type(part).model_fields.items() if getattr(part, name) != field.default}
            told.setdefault(type(part), set()).update(other)
    for section in sections():
        assert told[section] == set(section.model_fields), section


def test_units_are_those_of_the_code(tmp_path: Path) -> None:
    job = load_job(write(FILES, tmp_path))
    assert job.data.freqs == (131.25e6, 129.6875e6)
    assert job.data.channel_width == 97656.25
    assert job.data.lst_range == pytest.approx((23.0, 2.0), rel=1e-15)
    assert job.data.redundancy_tol == 0.05
    assert job.noise.sigma == 0.25
    assert job.basis.edge == 95.0
    assert load_job(write(OTHERS[-2], tmp_path)).prior.frequency.delay == pytest.approx(1e-7, rel=1e-15)
    assert load_job(write(OTHERS[-1], tmp_path)).prior.frequency.length == (5e6, 1e7)
    simulation = load_job(write(SIMULATION, tmp_path))
    assert simulation.sky.flux_range == pytest.approx((0.01, 1.0), rel=1e-15)
    simulate = simulation.data.simulate
    assert simulate is not None
    assert simulate.latitude == pytest.approx(5.729577951308232, rel=1e-15)
    assert (simulate.height, simulate.integration_time, simulate.channel_width) == (1000.0, 60.0, 1e6)


def test_file_names_are_relative_to_the_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "jobs"
    folder.mkdir()
    path = write(FILES, folder)
    monkeypatch.chdir(tmp_path)
    job = load_job(Path("jobs/job.toml"))
    assert job == load_job(path)
    assert job.data.files == (str(folder / "night*.uvh5"), "/elsewhere/night.uvh5")
    assert job.data.gains == (str(folder / "gains.calfits"),)
    assert job.sky.file == folder / "sky" / "gleam.vot"
    assert job.sky.diffuse == folder / ".." / "gsm"
    assert job.prior.file == folder / "prior.h5"
    assert job.beam.source == str(folder / "beam.fits")
    assert load_job(write(SIMULATION, folder)).beam.source == "airy"


def test_home_is_understood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/someone")
    job = load_job(write("[data]\nfiles = ['~/a.uvh5']\n[beam]\nsource = '~/beam.fits'", tmp_path))
    assert job.data.files == ("/home/someone/a.uvh5",)
    assert job.beam.source == "/home/someone/beam.fits"


@pytest.mark.parametrize("path", JOBS, ids=lambda path: os.fspath(path.relative_to(path.parents[1])))
def test_jobs_that_come_along_load(path: Path) -> None:
    assert load_job(path).name


def test_every_key_has_a_meaning() -> None:
    tables = 0
    for section in sections():
        for name, field in section.model_fields.items():
            kinds = (field.annotation, *get_args(field.annotation))
            if any(isinstance(kind, type) and issubclass(kind, Section) for kind in kinds):
                tables += 1
            else:
                assert field.description, f"{section.__name__}.{name}"
                assert not field.is_required() or (section in (Effect, Injected, SampledEffect) and name == "kind")
        assert section.__doc__
    assert tables == 20


def test_sections_do_not_change(tmp_path: Path) -> None:
    job = load_job(write(SIMULATION, tmp_path))
    with pytest.raises(ValidationError, match="frozen"):
        job.seed = 3  # type: ignore[misc]
