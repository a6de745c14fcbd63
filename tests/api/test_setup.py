"""A job file and objects in memory give the same posterior; what is wrong is told by the argument's name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from astropy import units
from astropy.coordinates import SkyCoord
from mpi4py import MPI
from pyradiosky import SkyModel
from pyuvdata import AiryBeam, BeamInterface, UVBeam, UVData

import hydrabeam_mpi as hb
from hydrabeam_mpi.inference.prior import DiagonalPrior

BASIS = {"n_modes": 24, "k_max": 24, "m_max": 2}
FREQS = [130e6, 131e6]
MODEL: dict[str, Any] = {"sky": {"n_sources": 50}, "beam": {"source": "airy", "diameter": 14.0}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files: data of two channels and four polarisations, some flagged; a beam; a catalogue."""
    folder = tmp_path_factory.mktemp("files")
    simulate = {
        "array": {"hex": [2, 3]},
        "n_times": 6,
        "freqs": FREQS,
        "nsamples": 1.0,
        "effects": [{"kind": "leakage"}],
    }
    mock = hb.simulate(
        {"data": {"simulate": simulate}, "sky": {"n_sources": 50}, "beam": {"source": "airy", "diameter": 14}}
    )
    mock.uvd.flag_array[5:40, 1] = True
    mock.uvd.nsample_array[40:60] = 0.5
    mock.uvd.write_uvh5(str(folder / "data.uvh5"))
    airy = AiryBeam(diameter=14.0, x_orientation="east")
    grid = {"axis1_array": np.deg2rad(np.arange(0, 360, 5.0)), "axis2_array": np.deg2rad(np.arange(0, 91.0, 1.0))}
    of_pixels = airy.to_uvbeam(freq_array=np.array(FREQS), beam_type="power", pixel_coordinate_system="az_za", **grid)
    of_pixels.write_beamfits(str(folder / "beam.beamfits"))
    rng = np.random.default_rng(3)
    sky = SkyModel(
        name=np.arange(40).astype(str),
        skycoord=SkyCoord(rng.uniform(0, 360, 40), rng.uniform(-80, 20, 40), unit="deg", frame="icrs"),
        stokes=np.stack([rng.uniform(1, 5, (1, 40)), *np.zeros((3, 1, 40))]) * units.Jy,
        spectral_type="spectral_index",
        spectral_index=np.full(40, -0.8),
        reference_frequency=np.full(40, 130e6) * units.Hz,
    )
    sky.write_skyh5(str(folder / "sky.skyh5"))
    return folder


def job_text(folder: Path, **tables: Any) -> Path:
    job = {
        "data": {"files": ["data.uvh5"], "polarization": "nn"},
        "beam": {"source": "beam.beamfits"},
        "sky": {"kind": "catalogue", "file": "sky.skyh5"},
        "basis": BASIS,
        **tables,
    }
    path = folder / "job.toml"
    path.write_text(tomli_w.dumps(job))
    return path


def objects(folder: Path) -> dict[str, Any]:
    sky, uvd = SkyModel.from_file(str(folder / "sky.skyh5")), UVData.from_file(str(folder / "data.uvh5"))
    return {"uvd": uvd, "beam": UVBeam.from_file(str(folder / "beam.beamfits")), "sky": sky}


def assert_same(one: hb.Result, two: hb.Result) -> None:
    np.testing.assert_array_equal(one.beam.mean, two.beam.mean)
    np.testing.assert_array_equal(one.beam.covariance, two.beam.covariance)
    for name, values in one.heldout.items():
        np.testing.assert_array_equal(values, two.heldout[name])


def test_objects_in_memory_give_what_their_files_give(folder: Path) -> None:
    given = objects(folder)
    kept = given["uvd"].copy(), given["beam"].copy()
    by_file = hb.infer(hb.Setup.from_job(job_text(folder)))
    by_object = hb.infer(hb.Setup(**given, basis=hb.FourierBessel(**BASIS), data={"polarization": "nn"}))
    assert by_file.beam.mean.shape == (2, 24)
    assert by_file.summary["n_data"] > 0
    assert_same(by_file, by_object)
    assert given["uvd"] == kept[0]
    assert given["beam"] == kept[1]


def test_a_channel_that_is_all_flagged_is_skipped(folder: Path) -> None:
    given = objects(folder)
    given["uvd"].flag_array[:, 0] = True
    rest = hb.infer(hb.Setup(**given, basis=BASIS, data={"freqs": [131e6]}))
    both = hb.infer(hb.Setup(**given, basis=BASIS))
    assert_same(both, rest)
    skipped = "Skipped 1 of 2 channels, of which all data are flagged: 130 MHz."
    assert [line for line in both.summary["warnings"] if line not in rest.summary["warnings"]] == [skipped]


def test_beam_interfaces_are_what_they_hold(folder: Path) -> None:
    given = objects(folder)
    given["beam"] = BeamInterface(given["beam"], beam_type="power")
    setup = hb.Setup(**given, basis=BASIS, data={"polarization": "nn"})
    assert_same(hb.infer(hb.Setup.from_job(job_text(folder))), hb.infer(setup))
    airy = BeamInterface(AiryBeam(diameter=14.0, x_orientation="east"), beam_type="power")
    named = hb.Setup(**{**given, "beam": {"source": "airy", "diameter": 14.0}}, basis=BASIS)
    assert_same(hb.infer(named), hb.infer(hb.Setup(**{**given, "beam": airy}, basis=BASIS)))


def test_phased_data_are_turned_back_in_a_copy(folder: Path) -> None:
    given = objects(folder)
    given["uvd"].phase(lon=1.0, lat=-0.5, cat_name="centre")
    kept = given["uvd"].copy()
    given["uvd"].write_uvh5(str(folder / "phased.uvh5"))
    setup = hb.Setup(**given, basis=BASIS, data={"polarization": "nn"})
    job = job_text(folder, data={"files": ["phased.uvh5"], "polarization": "nn"})
    assert_same(hb.infer(setup), hb.infer(hb.Setup.from_job(job)))
    assert given["uvd"] == kept


def test_variances_in_memory_are_those_of_a_constant_noise(folder: Path) -> None:
    given = objects(folder)
    by_number = hb.infer(hb.Setup(**given, basis=BASIS, noise={"kind": "constant", "sigma": 0.5}))
    for variance in (0.25, np.full((given["uvd"].Nblts, 2, 4), 0.25)):
        by_array = hb.infer(hb.Setup(**given, basis=BASIS, noise=np.array(variance)))
        np.testing.assert_array_equal(by_array.beam.mean, by_number.beam.mean)


def test_priors_in_memory_are_taken(folder: Path) -> None:
    given, wide = objects(folder), hb.infer(hb.Setup(**objects(folder), basis=BASIS))
    record = wide.content.channels[0].arrays
    prior = DiagonalPrior(record["prior_mean"], 1e-6 * record["prior_std"])
    narrow = hb.infer(hb.Setup(**given, basis=BASIS, prior=prior))
    assert np.all(narrow.beam.std <= 1e-6 * record["prior_std"] * (1 + 1e-9))


def test_nothing_public_is_imported_before_it_is_asked_for(mpiexec_python: Any) -> None:
    code = (
        "import sys, hydrabeam_mpi as hb; assert not {'mpi4py', 'astropy', 'pyuvdata', 'numpy'} & set(sys.modules);"
        "assert set(hb.__all__) <= set(dir(hb)); hb.load; assert 'mpi4py.MPI' not in sys.modules;"
        "import hydrabeam_mpi.inference.prior; assert callable(hb.infer); assert hb.Setup.from_job.__doc__"
    )
    assert mpiexec_python(1, code).returncode == 0


def wrong_shape(given: dict[str, Any]) -> None:
    given["noise"] = np.ones(7)


def nan(given: dict[str, Any]) -> None:
    given["uvd"].data_array[:] = np.nan


def metadata_alone(given: dict[str, Any]) -> None:
    given["uvd"] = given["uvd"].copy(metadata_only=True)


def other_frequency(given: dict[str, Any]) -> None:
    given["beam"].freq_array = given["beam"].freq_array + 50e6


def table(**tables: Any) -> Any:
    return lambda given: given.update(tables)


@pytest.mark.parametrize(
    ("spoil", "field", "words"),
    [
        (metadata_alone, "uvd data_array", "is not there; read the file with its data"),
        (nan, "uvd data_array", "unflagged NaN or infinite values"),
        (other_frequency, "beam freq", "the beam covers 180-181 MHz, not 130 MHz"),
        (wrong_shape, "noise", "is an array of float64 with the shape (7,)"),
        (table(sky=3), "sky", "is of type int; give a SkyModel"),
        (table(beam=3), "beam", "is of type int; give a UVBeam"),
        (table(uvd=[]), "uvd", "is of type list; give a UVData"),
        (table(prior=3), "prior", "is of type int; give a mapping"),
        (table(basis={"n_mode": 24}), "basis n_mode", "unknown key; did you mean 'n_modes'?"),
        (table(holdout={"kind": "lst"}), "holdout", "kind = 'lst' needs lst_ranges"),
        (table(holdout={"every": 7}), "holdout kind", "holds out nothing"),
        (table(data={"freqs": [100e6]}), "data freqs", "no channel within half a channel of 100.000000 MHz"),
    ],
)
def test_what_is_wrong_is_told_by_the_arguments_name(spoil: Any, field: str, words: str, folder: Path) -> None:
    given = {**objects(folder), "basis": BASIS}
    spoil(given)
    with pytest.raises(hb.InputError) as told:
        hb.infer(hb.Setup(**given))
    assert told.value.file is None
    assert told.value.field == field
    assert words in str(told.value)


RANKS = """
import sys
from mpi4py import MPI
import numpy as np
from pyuvdata import UVData
import hydrabeam_mpi as hb
world = MPI.COMM_WORLD
uvd = UVData.from_file(sys.argv[1]) if world.rank == 0 else None
result = hb.infer(hb.Setup(uvd, **MODEL, basis=BASIS, comm=world))
try:
    hb.Setup(uvd, noise=np.ones(7), comm=world)
except hb.InputError as error:
    assert error.field == "noise", error
if world.rank == 0:
    result.write(sys.argv[2])
"""


FAILS = """
import sys
from mpi4py.MPI import COMM_WORLD as world
import hydrabeam_mpi as hb
if sys.argv[2]:
    sys.excepthook = lambda kind, *_: print(f"own hook: {kind.__name__}", flush=True)
for _ in range(2):
    hb.Setup.from_job(sys.argv[1], world)
comm = world.Dup()
setup = hb.Setup(["data.uvh5"], comm=comm)
comm.Free()
if world.rank == 1:
    raise KeyError("of the script itself")
world.Barrier()
"""


@pytest.mark.parametrize("hook", ["", "own"])
def test_a_script_that_fails_on_one_rank_ends(hook: str, folder: Path, mpiexec_python: Any) -> None:
    done = mpiexec_python(2, FAILS, job_text(folder), hook, timeout=60)
    assert done.returncode == 1
    assert done.stderr.count("KeyError: 'of the script itself'") == 1
    assert "rank 1 of 2 failed" in done.stderr
    assert done.stdout.count("own hook: KeyError") == bool(hook)


def test_rank_0_holds_the_data_for_all(folder: Path, tmp_path: Path, mpiexec_python: Any) -> None:
    code = RANKS.replace("BASIS", repr(BASIS)).replace("MODEL", repr(MODEL))
    done = mpiexec_python(2, code, folder / "data.uvh5", tmp_path / "result")
    assert done.returncode == 0, done.stderr
    uvd = UVData.from_file(str(folder / "data.uvh5"))
    alone = hb.infer(hb.Setup(uvd, **MODEL, basis=BASIS))
    both = hb.load(tmp_path / "result")
    np.testing.assert_allclose(both.beam.mean, alone.beam.mean, rtol=0, atol=1e-9 * alone.beam.std.min())
    assert MPI.COMM_WORLD.size == 1
