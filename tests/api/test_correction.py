"""Data without the effects of the instrument: what was taken out, put in again, gives the data."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from numpy.typing import NDArray
from pyuvdata import UVCal, UVData
from pyuvdata.utils import uvcalibrate

import hydrabeam_mpi as hb
from hydrabeam_mpi.api import correction as correction_module
from hydrabeam_mpi.cli import main
from tests.api.nights import Nights
from tests.loop.test_loop_command import TWO

RUN = """
import sys
from hydrabeam_mpi.cli import main
assert main(["correct", sys.argv[1], "-o", sys.argv[2]]) == 0
"""
RUN_INTO = """
import sys
from pathlib import Path
from mpi4py.MPI import COMM_WORLD as world
import hydrabeam_mpi as hb
from hydrabeam_mpi.api.applied import setup_for
from hydrabeam_mpi.api.correction import run_correction
result = hb.load(sys.argv[1])
setup = setup_for(result, hb.Setup.from_job(sys.argv[2], world))
try:
    run_correction(result, setup, None, 1, into=Path(sys.argv[3]))
except hb.InputError as error:
    sys.stdout.write(f"{world.rank}: {error}\\n")  # at once, so that ranks do not mix
"""
PARTS = ("corrected", "model", "residual", "added")
GAIN = np.exp(0.06 - 0.05j)
"""Of antenna 2, by which the data of both nights are off."""


def flat(text: str) -> str:
    """Return text without the ends of lines, which calfits puts anywhere."""
    return text.replace("\n", "")


def crosses(path: Path) -> UVData:
    uvd = UVData.from_file(str(path))
    uvd.select(ant_str="cross")
    return uvd


def values_of(folder: Path) -> dict[str, NDArray[Any]]:
    return {name: crosses(folder / f"{name}.uvh5").data_array for name in PARTS}


@pytest.fixture(scope="module")
def corrected(nights: Nights) -> Path:
    """The first night, the result's own data."""
    out = nights.folder / "corrected"
    assert main(["correct", str(nights.result), "-o", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def coupled(nights: Nights) -> Path:
    """A result with a coupling, a baseline's factor and a compression besides, which the data do not have."""
    job = tomllib.loads((nights.result / "amended.toml").read_text())
    coupling = {
        "kind": "cross_coupling",
        "settings": {"baselines": [[4, 1]]},
        "names": ["baseline 1-4 real", "baseline 1-4 imaginary"],
        "index": [0, 1],
        "values": [[1e-5, 0.0]] * 2,
        "prior_std": [1e-4, 1e-4],
    }
    factor = coupling | {
        "kind": "closure_errors",
        "settings": {"baselines": [[2, 5]]},
        "names": ["baseline 2-5 ln amplitude", "baseline 2-5 phase"],
    }
    compression = {
        "kind": "compression",
        "names": ["compression of all antennas"],
        "index": [0],
        "values": [[1.0]] * 2,
        "prior_std": [10.0],
    }
    job["effects"] += [coupling, factor, compression]
    path = nights.folder / "coupled.toml"
    path.write_text(tomli_w.dumps(job))
    assert main(["infer", str(path), "-o", str(nights.folder / "coupled")]) == 0
    return nights.folder / "coupled"


@pytest.fixture(scope="module")
def jittering(nights: Nights) -> Path:
    """A result with an antenna whose amplitude jitters, of which the held-out times tell nothing."""
    job = tomllib.loads((nights.result / "amended.toml").read_text())
    jds = np.unique(UVData.from_file(str(nights.data("first"))).time_array)
    jitter = {
        "kind": "gain_jitter",
        "settings": {"gains_of": [[3, "ln amplitude"]]},
        "names": [f"antenna 3 ln amplitude at JD {jd:.5f}" for jd in jds],
        "index": list(range(len(jds))),
        "values": [[0.0] * len(jds)] * 2,
        "prior_std": [0.01] * len(jds),
    }
    job["effects"].append(jitter)
    path = nights.folder / "jittering.toml"
    path.write_text(tomli_w.dumps(job))
    assert main(["infer", str(path), "-o", str(nights.folder / "jittering")]) == 0
    return nights.folder / "jittering"


def test_gains_that_the_result_does_not_tell_are_flagged(
    jittering: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    capfd.readouterr()
    assert main(["correct", str(jittering), "-o", str(tmp_path / "out")]) == 0
    said = capfd.readouterr().err
    cal = UVCal.from_file(str(tmp_path / "out" / "gains.calfits"))
    jds = cal.time_array
    unknown = np.arange(len(jds)) % 3 == 2  # held out
    for antenna, flags, gains in zip(cal.ant_array, cal.flag_array, cal.gain_array, strict=True):
        np.testing.assert_array_equal(flags[..., 0], np.broadcast_to(unknown & (antenna == 3), (len(TWO), len(jds))))
        assert antenna != 3 or np.all(gains[:, ~unknown] != 1)
    uvd = UVData.from_file(str(tmp_path / "out" / "corrected.uvh5"))
    for pair in uvd.get_antpairs():
        expected = np.broadcast_to((unknown & (3 in pair))[:, np.newaxis], (len(jds), len(TWO)))
        np.testing.assert_array_equal(uvd.get_flags(pair), expected)
        np.testing.assert_array_equal(uvd.get_data(pair) == 0, expected)
    told = json.loads((tmp_path / "out" / "correction.json").read_text())
    (flagged,) = told["flagged"]
    assert flagged["antennas"] == [3]
    np.testing.assert_allclose(flagged["times_jd"], jds[unknown], atol=1e-6)
    assert "flagged: antenna 3 at 4 of 12 times: the result does not tell the gains at these times" in said
    assert [name.rsplit(" ", 1)[0] for name in told["at_prior"]] == [
        "antenna gains that jitter: antenna 3 ln amplitude at JD"
    ] * 4
    (carried,) = (one for one in told["carried_over"] if one["effect"] == "gain_jitter")
    assert len(carried["parameters"]) == 8


def test_what_the_result_left_out_is_flagged_in_its_own_data(nights: Nights, tmp_path: Path) -> None:
    """An integration, and one row of another, although the result had no antenna 6, of which noise has no scale."""
    uvd = UVData.from_file(str(nights.data("first")))
    jds = np.unique(uvd.time_array)
    burst = (uvd.time_array == jds[5]) & (uvd.ant_1_array == 1) & (uvd.ant_2_array == 4)
    uvd.data_array[burst] += 1000.0
    uvd.write_uvh5(str(tmp_path / "burst.uvh5"))
    job = tomllib.loads((nights.result / "amended.toml").read_text())
    job["data"] |= {"files": [str(tmp_path / "burst.uvh5")], "exclude_antennas": [6]}
    job["effects"] += [
        {"kind": "noise_level", "values": [[1.0] * 7] * 2},
        {"kind": "bad_integrations", "values": [[*[1.0] * 8, 9.0, *[1.0] * 3]] * 2},
        {"kind": "outliers", "values": [[1e5, 0.01, 1e6]] * 2},
    ]
    (tmp_path / "job.toml").write_text(tomli_w.dumps(job))
    assert main(["infer", str(tmp_path / "job.toml"), "-o", str(tmp_path / "found")]) == 0
    own = nights.job("first", "_burst", files=[str(tmp_path / "burst.uvh5")])
    correction = hb.correct(tmp_path / "found", hb.Setup.from_job(own), bad_antennas=[6])
    assert correction.observation is not None
    pairs = correction.observation.antpairs
    expected = np.zeros((len(TWO), 12, len(pairs)), dtype=bool)
    expected[:, 8] = expected[..., np.any(pairs == 6, axis=1)] = True
    expected[:, 5, np.all(pairs == [1, 4], axis=1)] = True
    np.testing.assert_array_equal(correction.flags[..., 0], expected)
    assert correction.summary["flagged"] == [
        {"why": "bad antennas", "antennas": [6]},
        {
            "why": "the result left them out (bad integrations and outliers)",
            "visibilities": len(TWO) * (15 + 1),
            "times_jd": [pytest.approx(jds[8], abs=1e-6)],
        },
    ]
    assert [one["effect"] for one in correction.summary["not_carried_over"]] == ["noise_level"]
    other = hb.correct(tmp_path / "found", hb.Setup.from_job(nights.job("second")))
    assert not other.flags.any()
    assert other.summary["flagged"] == []
    left = [one["effect"] for one in other.summary["not_carried_over"]]
    assert left == ["noise_level", "bad_integrations", "outliers"]


def test_gains_divide_the_data(nights: Nights, corrected: Path) -> None:
    cal = UVCal.from_file(str(corrected / "gains.calfits"))
    assert (cal.gain_convention, cal.gain_scale, cal.pol_convention) == ("divide", "Jy", "sum")
    gain = cal.gain_array[cal.ant_array.tolist().index(2)]
    np.testing.assert_allclose(gain, GAIN, atol=0.002)
    own, said = UVData.from_file(str(nights.data("first"))).history.split("Read/written")[0].strip(), flat(cal.history)
    assert said.startswith(flat(own))
    assert said.find("Gains of effects that were taken out of data, V / (g_i g_j*). The job named no gains") > 0
    assert f"Effects taken out: antenna gains. Written by hydrabeam_mpi {hb.__version__}, result " in said
    uvd = UVData.from_file(str(nights.data("first")))
    uvcalibrate(uvd, cal)
    own = UVData.from_file(str(corrected / "corrected.uvh5"))
    for pair in uvd.get_antpairs():
        np.testing.assert_allclose(own.get_data(pair), uvd.get_data(pair), rtol=1e-12)
        assert not own.get_flags(pair).any()
    before, _, after = own.history.partition(
        "\nVisibilities without the instrument's effects: (V / (g_i g_j*) - added). "
    )
    assert before == UVData.from_file(str(nights.data("first"))).history
    assert after.startswith("Effects taken out: antenna gains. Written by hydrabeam_mpi ")
    assert "result " + str(nights.result) + ".\nObject created by" in after


def test_parts_are_what_they_are_called(corrected: Path) -> None:
    parts = values_of(corrected)
    scale = np.abs(parts["corrected"]).max()
    np.testing.assert_allclose(parts["model"] + parts["residual"], parts["corrected"], atol=1e-15 * scale)
    assert not parts["added"].any()
    assert np.sqrt(np.mean(np.abs(parts["residual"]) ** 2)) < 0.01 * np.sqrt(np.mean(np.abs(parts["model"]) ** 2))


def test_put_in_again_they_are_the_data_on_any_number_of_ranks(
    nights: Nights, coupled: Path, tmp_path: Path, mpiexec_python: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(correction_module, "BLOCK_BYTES", 10_000)  # two times at once
    assert main(["correct", str(coupled), "-o", str(tmp_path / "one")]) == 0
    done = mpiexec_python(2, RUN, coupled, tmp_path / "two")
    assert done.returncode == 0, done.stderr
    one, two = (values_of(tmp_path / name) for name in ("one", "two"))
    for name in PARTS:
        np.testing.assert_allclose(two[name], one[name], rtol=1e-12, atol=1e-13 * np.abs(one[name]).max())
    again, data = crosses(tmp_path / "one" / "corrected.uvh5"), crosses(nights.data("first"))
    cal = UVCal.from_file(str(tmp_path / "one" / "gains.calfits"))
    assert again.get_antpairs() == data.get_antpairs()
    again.data_array += one["added"]
    uvcalibrate(again, cal, undo=True)
    np.testing.assert_allclose(again.data_array, data.data_array, rtol=1e-12)
    # Gains that follow the power are among these, for autocorrelations, too.
    assert np.ptp(np.abs(cal.gain_array[0]), axis=1).max() > 1e-6
    autos = UVData.from_file(str(tmp_path / "one" / "corrected.uvh5"))
    uvcalibrate(autos, cal, undo=True)
    data = UVData.from_file(str(nights.data("first")))
    np.testing.assert_allclose(autos.get_data(3, 3), data.get_data(3, 3), rtol=1e-12)
    added = crosses(tmp_path / "one" / "added.uvh5")
    assert [pair for pair in added.get_antpairs() if added.get_data(pair).any()] == [(1, 4), (2, 5)]


def test_other_data_in_python(nights: Nights, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correction_module, "BLOCK_BYTES", 10_000)
    job = nights.job("second", "_flagged", exclude_baselines=[[0, 3]])
    correction = hb.correct(hb.load(nights.result), hb.Setup.from_job(job), bad_antennas=[5])
    assert correction.observation is not None
    pairs = correction.observation.antpairs
    flagged = np.any(pairs == 5, axis=1) | np.all(pairs == [0, 3], axis=1)
    np.testing.assert_array_equal(correction.flags, np.broadcast_to(flagged[:, np.newaxis], correction.flags.shape))
    corrected = correction.visibilities["corrected"]
    assert not corrected[:, :, flagged].any()
    uvd = crosses(nights.data("second"))
    for number in np.flatnonzero(~flagged):
        one, two = pairs[number].tolist()
        expected = uvd.get_data(one, two).T
        off = {one: 1 / GAIN, two: 1 / GAIN.conj()}.get(2, 1.0)
        np.testing.assert_allclose(corrected[:, :, number, 0], expected * off, rtol=0.01)
    assert [one["effect"] for one in correction.summary["carried_over"]] == ["antenna_gains", "missing_sources"]
    assert correction.autos.shape[2] == 7


def test_files_that_cannot_be_finished_end_all_ranks(nights: Nights, tmp_path: Path, mpiexec_python: Any) -> None:
    (tmp_path / "residual.uvh5").mkdir()  # no file can be renamed to that
    done = mpiexec_python(2, RUN_INTO, nights.result, nights.job("first"), tmp_path, timeout=100)
    assert done.returncode == 0, done.stderr
    lines = sorted(done.stdout.splitlines())
    assert [line[:2] for line in lines] == ["0:", "1:"]
    assert all("residual.uvh5: cannot be written" in line for line in lines)


def test_autocorrelations_keep_flags_and_samples(nights: Nights) -> None:
    uvd = UVData.from_file(str(nights.data("second")))
    uvd.flag_array[uvd.antpair2ind(1, 1, ordered=False)][3:5] = True
    uvd.nsample_array[uvd.antpair2ind(4, 4, ordered=False)] = 0.25
    path = nights.folder / "bad_autos.uvh5"
    uvd.write_uvh5(str(path), clobber=True)
    job = nights.job("second", "_bad_autos", files=[str(path)])
    out = nights.folder / "bad_autos"
    hb.correct(nights.result, hb.Setup.from_job(job), bad_antennas=[5]).write(out)
    own = UVData.from_file(str(out / "corrected.uvh5"))
    for antenna in range(7):
        expected = uvd.get_flags(antenna, antenna) | (antenna == 5)
        np.testing.assert_array_equal(own.get_flags(antenna, antenna), expected)
        np.testing.assert_array_equal(own.get_data(antenna, antenna) == 0, expected)
        np.testing.assert_array_equal(own.get_nsamples(antenna, antenna), uvd.get_nsamples(antenna, antenna))
    cal = UVCal.from_file(str(out / "gains.calfits"))
    np.testing.assert_array_equal(cal.flag_array.all(axis=(1, 2, 3)), cal.ant_array == 5)
    assert cal.flag_array.sum() == cal.flag_array[0].size
