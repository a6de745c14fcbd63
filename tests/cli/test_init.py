"""A job printed from data says what the data hold, loads, and runs."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord
from pyradiosky import SkyModel
from pyuvdata import UVData

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.commands.init import CATALOGUE, job_from_data
from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.effects import Loop
from hydrabeam_mpi.config.named import expand
from hydrabeam_mpi.config.sections import Basis, Beam, Data, Holdout, Noise, Output, Prior, Sky, SkyColumns, Solver
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.posterior_file import read_posterior
from tests.cli.conftest import Workspace
from tests.visibilities import CROSS, ENU, NUMBERS, SECOND, make_uvdata


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a file of visibilities, changed as asked."""

    def make(change: Callable = lambda uv: None, name: str = "made.uvh5", **options) -> Path:
        uv = make_uvdata(**options)
        change(uv)
        uv.write_uvh5(tmp_path / name, run_check=False)
        return tmp_path / name

    return make


def load(text: str, folder: Path) -> Job:
    (folder / "job.toml").write_text(text)
    return load_job(folder / "job.toml")


def test_printed_job_infers_what_a_written_one_does(
    workspace: Workspace, result: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    truth_to_catalogue(workspace)
    capfd.readouterr()
    assert main(["init", str(workspace.data)]) == 0
    text, err = capfd.readouterr()
    assert not err
    # What a user does: name the catalogue. The small basis and the plain rotation are those of the simulation.
    text = text.replace(CATALOGUE, "truth.skyh5").replace('# positions = "..."', 'positions = "lst"')
    for key, value in {"n_modes": 16, "k_max": 8, "m_max": 4, "draws": 2}.items():
        text = re.sub(rf"^# {key} = \d+", f"{key} = {value}", text, flags=re.MULTILINE)
    job = workspace.write("job.toml", text)
    assert main(["infer", str(job), "-o", str(workspace.folder / "result")]) == 0
    found, expected = (
        read_posterior(folder / "posterior.h5").channels[0].arrays for folder in (workspace.folder / "result", result)
    )
    np.testing.assert_allclose(found["mean"], expected["mean"], atol=1e-6 * expected["std"].min())


def truth_to_catalogue(workspace: Workspace) -> None:
    """Write the simulated sky as a catalogue."""
    with h5py.File(workspace.simulated / "truth.h5") as file:
        ra, dec, flux = file["ra"][()], file["dec"][()], file["flux"][()]
    stokes = np.zeros((4, 1, len(ra)))
    stokes[0] = flux
    SkyModel(
        name=[f"source {i}" for i in range(len(ra))],
        skycoord=SkyCoord(ra * units.rad, dec * units.rad, frame="icrs"),
        stokes=stokes * units.Jy,
        spectral_type="flat",
    ).write_skyh5(workspace.folder / "truth.skyh5")


SECTIONS = (Data, Noise, Holdout, Sky, SkyColumns, Beam, Basis, Prior, Solver, Output, Loop)


def test_keys_in_comments_are_at_their_defaults(write: Callable[..., Path], tmp_path: Path) -> None:
    text = job_from_data([write()])
    # Those without a default have dots.
    taken_in = re.sub(r"^# (\w+ = (?!.*\.\.\.))", r"\1", text, flags=re.MULTILINE)
    assert taken_in.count("\n#") < text.count("\n#") - 20
    job = load(taken_in.replace("# [sky.columns]", "[sky.columns]"), tmp_path)
    assert job.sky.columns == SkyColumns()
    without = job.sky.model_copy(update={"columns": None})
    assert job.model_copy(update={"sky": without}) == load(text, tmp_path)


def test_every_key_is_printed_with_its_meaning(write: Callable[..., Path]) -> None:
    lines = job_from_data([write()]).splitlines()
    for section in SECTIONS:
        for name, field in section.model_fields.items():
            if field.description is None:
                assert name in ("simulate", "columns")
                continue
            found = [i for i, line in enumerate(lines) if re.match(rf"(# )?{name} = ", line)]
            assert found, name
            assert any(field.description in lines[i] + lines[i - 1] for i in found), name


def test_data_are_described(write: Callable[..., Path], tmp_path: Path) -> None:
    def flag(uv: UVData) -> None:
        uv.flag_array[:, 2] = True
        uv.flag_array[(uv.ant_1_array == 7) | (uv.ant_2_array == 7)] = True
        # What is flagged of the other polarisation, or of autocorrelations, is of no concern.
        uv.flag_array[:, :, 1] = True
        uv.flag_array[(uv.ant_1_array == 3) & (uv.ant_2_array == 3)] = True
        uv.pol_convention = "avg"

    path = write(flag)
    text = job_from_data([path])
    assert "Telescope made, antennas 3, 7, 11, 20, 41." in text
    ends = [[ENU[NUMBERS.index(ant)] for ant in pair] for pair in CROSS]
    lengths = sorted(float(np.linalg.norm(two - one)) for one, two in ends)
    assert f"6 baselines of {lengths[0]:.1f} to {lengths[-1]:.1f} m; different ones: 6 within redundancy_tol" in text
    assert "Times: 6, each 10 s, on JD 2459866, LST " in text
    assert "Channels: 4, from 120 MHz to 123 MHz, 1 MHz apart and 1 MHz wide." in text
    assert "Polarisations: ee, nn." in text
    assert "Wholly flagged channels: 122 MHz." in text
    assert "Wholly flagged antennas: 7." in text
    assert "The files state the pol_convention avg." in text
    assert "nsamples is 0.25 to 2." in text
    assert "Every antenna has autocorrelations." in text
    job = load(text, tmp_path)
    assert job.data.files == (str(path),)
    assert job.data.polarization == "ee"
    assert job.data.exclude_antennas == (7,)
    assert job.data.freqs == (120e6, 121e6, 123e6)
    assert job.noise.kind == "autocorrelations"
    assert job.beam.frequency == "scale"


def test_dead_and_absurd_antennas_are_left_out(write: Callable[..., Path], tmp_path: Path) -> None:
    """Autocorrelations of 3e-6 beside a thousand, and visibilities of nothing but zeros."""

    def damage(uv: UVData) -> None:
        autos = uv.ant_1_array == uv.ant_2_array
        uv.data_array[autos & (uv.ant_1_array == 11)] = 3e-6
        uv.data_array[~autos & ((uv.ant_1_array == 20) | (uv.ant_2_array == 20))] = 0

    text = job_from_data([write(damage)])
    assert "Dead or absurd antenna 11: its autocorrelations are 2." in text
    assert "Dead or absurd antenna 20: all its visibilities are zero." in text
    assert load(text, tmp_path).data.exclude_antennas == (11, 20)


def test_antennas_of_unlike_power_are_not_absurd(write: Callable[..., Path], tmp_path: Path) -> None:
    def scale(uv: UVData) -> None:
        for ant, power in zip(NUMBERS, (0.3, 0.8, 1.0, 1.5, 4.0), strict=True):
            uv.data_array[(uv.ant_1_array == ant) & (uv.ant_2_array == ant)] *= power

    text = job_from_data([write(scale)])
    assert "absurd" not in text
    assert load(text, tmp_path).data.exclude_antennas == ()


HOSTILE = 'made\n\npolarization = \'nn\' # \x1b[2J\u2028\x7f\r"""\\ größer 面'


def test_names_from_files_stay_in_their_comments(write: Callable[..., Path], tmp_path: Path) -> None:
    def rename(path: Path, name: str) -> None:
        with h5py.File(path, "r+") as file:
            for key in ("telescope_name", "vis_units"):
                del file[f"Header/{key}"]
                file[f"Header/{key}"] = np.bytes_(name.encode())

    path = write()
    texts = []
    for name in (HOSTILE, "plain"):
        rename(path, name)
        texts.append(job_from_data([path]))
    hostile, plain = texts
    assert hostile.count("größer 面") == 2
    assert all(line.isprintable() for line in hostile.splitlines())
    assert len(hostile.splitlines()) == len(plain.splitlines())
    assert load(hostile, tmp_path) == load(plain, tmp_path)


def test_names_of_files_survive(write: Callable[..., Path], tmp_path: Path) -> None:
    path = write(name='it\'s "größer" \\ 面.uvh5')
    job = load(job_from_data([path]), tmp_path)
    assert job.name == path.stem
    assert expand(job.data.files, "[data] files") == (path,)


@pytest.mark.parametrize("name", ["a\nb.uvh5", "a\udcff.uvh5"])
def test_names_that_no_job_can_hold(name: str, write: Callable[..., Path], tmp_path: Path) -> None:
    write().rename(tmp_path / name)
    with pytest.raises(InputError, match=r"a job file cannot hold a name like this; rename it"):
        job_from_data([tmp_path / name])


def test_range_of_lst_may_wrap(write: Callable[..., Path]) -> None:
    times = 2459866.2 + np.array([0.0, 0.1, 0.2])
    said = re.search(r"LST ([\d.]+) to ([\d.]+) h", job_from_data([write(times=times)]))
    assert said is not None
    first, last = float(said[1]), float(said[2])
    assert first > last
    assert (last - first) % 24 == pytest.approx(4.8 * 1.0027379, abs=2e-3)


@pytest.mark.parametrize(
    ("n_times", "kind"), [(40, "time-differences"), (6, "frequency-differences")], ids=["many times", "few times"]
)
def test_noise_without_autocorrelations(n_times: int, kind: str, write: Callable[..., Path], tmp_path: Path) -> None:
    path = write(antpairs=CROSS, times=2459866.2 + 10 * SECOND * np.arange(n_times))
    text = job_from_data([path])
    assert "Not every antenna has autocorrelations." in text
    assert load(text, tmp_path).noise.kind == kind


def test_one_of_many_channels_and_no_holdout_of_one_time(write: Callable[..., Path], tmp_path: Path) -> None:
    path = write(freqs=125e6 + 1e6 * np.arange(12), times=np.array([2459866.2]))
    job = load(job_from_data([path]), tmp_path)
    assert job.data.freqs == (131e6,)
    assert job.beam.frequency == "match"
    assert job.holdout.kind == "none"


def test_another_polarisation_needs_a_beam(write: Callable[..., Path], tmp_path: Path) -> None:
    text = job_from_data([write(pols=(-6,))])
    job = load(text, tmp_path)
    assert job.data.polarization == "nn"
    assert job.beam.source == str(tmp_path / "BEAM.beamfits")
    assert "CHOOSE the beam in 'source'." in text


def test_circular_feeds_are_refused(write: Callable[..., Path]) -> None:
    def make_circular(uv: UVData) -> None:
        uv.polarization_array = np.array([-1, -2])
        uv.telescope.feed_array = np.array([["r", "l"]] * uv.telescope.Nants)

    with pytest.raises(
        InputError, match=r"made.uvh5: polarization_array: only the polarisations rr, ll, .*; give data"
    ):
        job_from_data([write(make_circular)])


def test_all_flagged_is_told(write: Callable[..., Path]) -> None:
    text = job_from_data([write(lambda uv: uv.flag_array.fill(True))])
    assert "All cross-correlations are flagged." in text
    assert "Wholly flagged antennas: 3, 7, 11, 20, 41." in text


def test_several_files_and_names_like_wildcards(write: Callable[..., Path], tmp_path: Path) -> None:
    paths = [
        write(name="night[1].uvh5"),
        write(name="night[2].uvh5", times=2459867.2 + 10 * SECOND * np.arange(3)),
    ]
    text = job_from_data(paths)
    assert "Times: 9, each 10 s, on JD 2459866-2459867" in text
    job = load(text, tmp_path)
    assert expand(job.data.files, "[data] files") == tuple(paths)


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("H1C_2458042_LST5.7/*", ["Wholly flagged antennas: 0, 11.", "1.5625 MHz apart and 97.65625 kHz wide"]),
        ("H1C_lstbin_LST4.95/zen.even*", ["45 baselines", "14 within 0.1 m", "nsamples is 6 to 18."]),
    ],
    ids=["uvh5", "miriad"],
)
def test_measured_data(pattern: str, said: list[str], data_dir: Path, tmp_path: Path) -> None:
    text = job_from_data(sorted(data_dir.glob(pattern)))
    assert [words for words in said if words not in text] == []
    assert len(load(text, tmp_path).data.freqs or ()) == 1
