"""A job printed from data says what the data hold, loads, and runs."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from pyuvdata import UVData

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.commands.init import job_from_data
from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.data import Data
from hydrabeam_mpi.config.effects import Loop
from hydrabeam_mpi.config.frequency import OverFrequency
from hydrabeam_mpi.config.named import expand
from hydrabeam_mpi.config.sections import Basis, Beam, Holdout, Noise, Output, Prior, Sky, SkyColumns, Smooth, Solver
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.posterior_file import read_posterior
from tests.cli.conftest import Workspace
from tests.visibilities import CROSS, ENU, NUMBERS, SECOND, TIMES, make_uvcal, make_uvdata


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


SMALL = {"n_modes": 16, "k_max": 8, "m_max": 4, "draws": 2}
"""The size of the basis, and how much is written, which no data tell."""


def printed(*files: Path, capfd: pytest.CaptureFixture[str]) -> str:
    """Return what init prints, for the small basis of the simulation."""
    capfd.readouterr()
    assert main(["init", *map(str, files)]) == 0
    text, err = capfd.readouterr()
    assert not err
    for key, value in SMALL.items():
        text = re.sub(rf"^# {key} = \d+", f"{key} = {value}", text, flags=re.MULTILINE)
    return text


def test_simulated_data_are_inferred_as_by_the_job_that_simulated_them(
    workspace: Workspace, result: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = printed(workspace.data, capfd=capfd)
    assert text.count("CHOOSE") == 1  # in the head, which explains it
    assert "# 50 sources of sky.skyh5." in text
    job = workspace.write("job.toml", text)
    assert main(["infer", str(job), "-o", str(workspace.folder / "result")]) == 0
    found, expected = (
        read_posterior(folder / "posterior.h5").channels[0].arrays for folder in (workspace.folder / "result", result)
    )
    np.testing.assert_allclose(found["mean"], expected["mean"], atol=1e-9 * expected["std"].min())
    np.testing.assert_allclose(found["std"], expected["std"], rtol=1e-9)


def test_gains_beam_and_sky_are_told_from_data(
    workspace: Workspace, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """All of them elsewhere than the simulation has left them, so that nothing is known but what is in them."""
    names = ("data.uvh5", "sky.skyh5", "true_beam.beamfits")
    data, sky, beam = (tmp_path / name for name in names)
    for name in names:
        shutil.copy(workspace.simulated / name, tmp_path / name)
    uv = UVData.from_file(data)
    gains = make_uvcal(uv, times=np.unique(uv.time_array), jones=(-5,), numbers=range(7))
    gains.write_calfits(str(tmp_path / "gains.fits"))
    job = load(printed(sky, tmp_path / "gains.fits", data, beam, capfd=capfd), tmp_path)
    assert job.data.files == (str(data),)
    assert job.data.gains == (str(tmp_path / "gains.fits"),)
    assert (job.sky.file, job.sky.positions) == (sky, "lst")
    assert (job.beam.source, job.beam.frequency) == (str(beam), "match")
    assert main(["infer", str(tmp_path / "job.toml"), "-o", str(tmp_path / "result")]) == 0


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["sky.skyh5"], "sky.skyh5: no visibilities, but a sky; name their files, too"),
        (["data.uvh5", "sky.skyh5", "sky.skyh5"], "sky.skyh5: a sky, and so is sky.skyh5; name one of them"),
    ],
)
def test_files_that_make_no_job(names: list[str], said: str, workspace: Workspace) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        job_from_data([workspace.simulated / name for name in names])


def test_job_is_written_where_asked(workspace: Workspace, capfd: pytest.CaptureFixture[str]) -> None:
    job = workspace.folder / "new.toml"
    init = ["init", str(workspace.data), "-o", str(job)]
    assert main(init) == 0
    assert capfd.readouterr() == ("", f"hydrabeam: wrote {job}\n")
    assert load_job(job).sky.file == workspace.simulated / "sky.skyh5"
    job.write_text("mine")
    assert main(init) == 2
    assert job.read_text() == "mine"
    assert "is there already" in capfd.readouterr().err
    assert main([*init, "--overwrite"]) == 0
    assert load_job(job).name == "data"


SECTIONS = (Data, Noise, Holdout, Sky, SkyColumns, Beam, Basis, Prior, Smooth, OverFrequency, Solver, Output, Loop)


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
                assert name in ("simulate", "columns", "smooth", "frequency")
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
    assert job.data.pol == "ee"
    assert job.data.exclude_antennas == (7,)
    assert job.data.freqs == (120e6, 121e6, 123e6)
    assert job.noise.kind == "autocorrelations"
    assert job.beam.frequency == "scale"


def test_flagged_channels_are_told_as_ranges(write: Callable[..., Path]) -> None:
    def flag(uv: UVData) -> None:
        uv.flag_array[:, [1, 4, 5, 6]] = True

    text = job_from_data([write(flag, freqs=120e6 + 1e6 * np.arange(8))])
    assert "Wholly flagged channels: 121, 124 to 126 (3 channels) MHz." in text


@pytest.mark.parametrize(("error", "proposed"), [(0.0, None), (2e-3, "0.01 m")])
def test_tolerance_is_proposed_where_surveyed_places_split_baselines(
    error: float, proposed: str | None, write: Callable[..., Path], tmp_path: Path
) -> None:
    east = np.outer(np.arange(5), [14.6, 0.0, 0.0]) + error * np.random.default_rng(1).uniform(-1, 1, (5, 3))
    text = job_from_data([write(enu=east)])
    found = re.search(r'CHOOSE redundancy_tol = "(.*)" to take', text)
    assert (found and found[1]) == proposed
    if proposed:
        job = load(re.sub(r"^# redundancy_tol = \S+ m\"", f'redundancy_tol = "{proposed}"', text, flags=re.M), tmp_path)
        assert job.data.redundancy_tol == 0.01


def test_files_that_state_the_feeds_in_different_ways(write: Callable[..., Path], tmp_path: Path) -> None:
    """Of the same times: xx is ee in one, and yy in the other; and one that states nothing is named."""
    east = write(pols=(-5,), name="east.uvh5")
    north = write(pols=(-5,), x_orientation="north", name="north.uvh5")
    text = job_from_data([east, north])
    assert "Polarisations: ee, nn." in text
    assert load(text, tmp_path).data.pol == "ee"
    silent = write(pols=(-5,), x_orientation=None, times=TIMES + 1, name="silent.uvh5")
    with pytest.raises(InputError, match=r"silent.uvh5: feed_angle: does not tell .*, and east.uvh5 does: x east; if"):
        job_from_data([east, silent])
    with pytest.raises(InputError, match=r"and north.uvh5 does: x north; if .*orientation\('north'\) states it"):
        job_from_data([north, silent])


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


def test_data_of_nothing_but_zeros_are_refused(write: Callable[..., Path]) -> None:
    """No antenna is left of them, and no job would say so."""

    def damage(uv: UVData) -> None:
        uv.data_array[uv.ant_1_array != uv.ant_2_array] = 0

    path = write(damage)
    with pytest.raises(InputError, match=rf"{path.name}.*: all visibilities that are not flagged are zero"):
        job_from_data([path])


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


def test_noise_that_nothing_tells_is_to_be_chosen(write: Callable[..., Path], tmp_path: Path) -> None:
    """Neither are there enough times, nor has the one channel neighbours; a job without it is refused, and says why."""
    path = write(antpairs=CROSS, times=2459866.2 + 10 * SECOND * np.arange(6), freqs=np.array([131e6]))
    text = job_from_data([path])
    assert "CHOOSE sigma" in text
    with pytest.raises(InputError, match=r"sigma"):
        load(text, tmp_path)
    job = load(text.replace('kind = "constant"', 'kind = "constant"\nsigma = "0.1 Jy"', 1), tmp_path)
    assert (job.noise.kind, job.noise.sigma) == ("constant", 0.1)


def test_one_of_many_channels_and_no_holdout_of_one_time(write: Callable[..., Path], tmp_path: Path) -> None:
    path = write(freqs=125e6 + 1e6 * np.arange(12), times=np.array([2459866.2]))
    job = load(job_from_data([path]), tmp_path)
    assert job.data.freqs == (131e6,)
    assert job.beam.frequency == "match"
    assert job.holdout.kind == "none"


def test_another_polarisation_needs_a_beam(write: Callable[..., Path], tmp_path: Path) -> None:
    text = job_from_data([write(pols=(-6,))])
    job = load(text, tmp_path)
    assert job.data.pol == "nn"
    assert job.beam.source == str(tmp_path / "BEAM.beamfits")
    assert "CHOOSE the beam in 'source'." in text


def test_circular_feeds_are_refused(write: Callable[..., Path]) -> None:
    def make_circular(uv: UVData) -> None:
        uv.polarization_array = np.array([-1, -2])
        uv.telescope.feed_array = np.array([["r", "l"]] * uv.telescope.Nants)

    with pytest.raises(
        InputError, match=r"made.uvh5: polarization_array: only the polarisations rr, ll, .*; give the data"
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
