"""A result as the prior of the next job: nights one after the other are as both at once, and none counts twice."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVData

import hydrabeam_mpi as hb
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.inferred import Inferred, read_inferred
from hydrabeam_mpi.io.uvdata import read_observation
from hydrabeam_mpi.setup.earlier import check_not_counted
from tests.api.nights import JOB as NIGHTS_JOB
from tests.api.nights import Nights
from tests.loop.mock import mock_job, write_job
from tests.loop.test_loop_command import TWO

JOB = mock_job(freqs=TWO)
NIGHTS: tuple[dict[str, Any], ...] = (
    {"lst_range": [0.0, 6.0]},
    {"start": 2459867.0, "lst_range": [6.1, 12.1]},
    {"start": 2459868.0, "lst_range": [12.2, 18.2]},
)


class Files:
    """Three nights of one array and sky, and results of them, made when they are asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for number, changes in enumerate(NIGHTS):
            settings = {**JOB["data"]["simulate"], **changes}
            job = write_job({**JOB, "data": {"simulate": settings}}, folder, f"simulate{number}.toml")
            assert main(["simulate", str(job), "-o", str(folder / f"night{number}")]) == 0

    def data(self, *nights: int) -> list[str]:
        return [str(self.folder / f"night{night}" / "data.uvh5") for night in nights]

    def job(self, nights: tuple[int, ...], prior: Path | None = None, **tables: Any) -> Path:
        before = {} if prior is None else {"prior": {"file": str(prior)}}
        job = {**JOB, **tables, **before, "data": {"files": self.data(*nights), **tables.get("data", {})}}
        return write_job(job, self.folder, "job.toml")

    def result(self, *nights: int, prior: Path | None = None, name: str = "result", **tables: Any) -> Path:
        """Infer from some nights at once, with what others have told as the prior."""
        out = self.folder / f"{prior.name if prior else name}-{''.join(map(str, nights))}"
        if not out.exists():
            assert main(["infer", str(self.job(nights, prior, **tables)), "-o", str(out)]) == 0
        return out


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    return Files(tmp_path_factory.mktemp("earlier"))


def assert_same(one: hb.Result, two: hb.Result, within: float) -> None:
    """Beams agree to a fraction of their standard deviation, and so do the standard deviations."""
    np.testing.assert_array_less(np.abs(one.beam.mean - two.beam.mean), within * two.beam.std)
    np.testing.assert_array_less(np.abs(one.beam.std - two.beam.std), within * two.beam.std)
    spread = two.beam.std[:, :, np.newaxis] * two.beam.std[:, np.newaxis]
    np.testing.assert_array_less(np.abs(one.beam.covariance - two.beam.covariance), within * spread)


def entry(kind: str, names: list[str], step: int = 1, **settings: Any) -> dict[str, Any]:
    """Return an effect that is to be fitted, with a prior of a tenth; ``names`` are one in ``step`` of all."""
    n = len(names)
    fitted = {"index": list(range(0, n * step, step)), "values": [[0.0] * n] * len(TWO), "prior_std": [[0.1] * n]}
    return {"kind": kind, "settings": settings, "names": names, **fitted}


PAIRS = [[0, 1], [2, 3], [0, 5]]
COUPLING = entry(
    "cross_coupling", [f"baseline {i}-{j} {part}" for i, j in PAIRS for part in ("real", "imaginary")], baselines=PAIRS
)
AMPLITUDES = entry("antenna_gains", [f"antenna {i} ln amplitude" for i in range(7)], step=2)
DELAYS = entry("antenna_delays", [f"antenna {i} {what}" for i in range(7) for what in ("delay", "phase")])


def assert_same_effects(one: Path, two: Path, within: float) -> None:
    """Effects and their joint errors agree, and how the beam follows them."""
    first, second = hb.load(one).content, hb.load(two).content
    assert first.effects is not None
    assert second.effects is not None
    for mine, wanted in zip(first.effects["entries"], second.effects["entries"], strict=True):
        assert mine["names"] == wanted["names"]
        assert mine["prior_std"] == wanted["prior_std"]
        np.testing.assert_array_less(np.abs(np.subtract(mine["values"], wanted["values"])) / wanted["std"], within)
    for mine, wanted in zip(first.channels, second.channels, strict=True):
        spread = wanted.arrays["effects_covariance"]
        sigma = np.sqrt(np.diag(spread))
        away = np.abs(mine.arrays["effects_covariance"] - spread) / sigma / sigma[:, np.newaxis]
        np.testing.assert_array_less(away, within)


def evidence(result: hb.Result) -> np.ndarray:
    return np.array([channel["log_evidence"] for channel in result.summary["channels"]])


def test_nights_one_after_the_other_are_as_all_at_once(files: Files) -> None:
    """Also the evidence, p(d1, d2, d3) = p(d1) p(d2 | d1) p(d3 | d1, d2), but for rounding of all that the data say."""
    first = files.result(0)
    second = files.result(1, prior=first)
    third, at_once = hb.load(files.result(2, prior=second)), hb.load(files.result(0, 1, 2))
    assert_same(third, at_once, 1e-6)
    steps = [hb.load(first), hb.load(second), third]
    np.testing.assert_allclose(sum(map(evidence, steps)), evidence(at_once), atol=1e-3)
    about = json.loads((second / "provenance.json").read_text())
    assert about["sha256_before"] == json.loads((first / "provenance.json").read_text())["sha256"]
    assert str(first) in about["sha256"]


def test_effects_that_add_are_as_of_all_at_once(files: Files) -> None:
    """Beam and constant couplings together are a linear model, so that this is exact."""
    first = files.result(0, name="coupling", effects=[COUPLING])
    second, at_once = files.result(1, prior=first), files.result(0, 1, name="coupling", effects=[COUPLING])
    assert_same(hb.load(second), hb.load(at_once), 1e-6)
    assert_same_effects(second, at_once, 1e-6)
    told = hb.load(second).summary["prior"]
    assert told["result"] == str(first)
    assert [(one["effect"], one["parameters"]) for one in told["carried_over"]] == [
        ("cross_coupling", COUPLING["names"])
    ]


def test_amplitudes_and_delays_are_as_of_all_at_once(files: Files) -> None:
    """But for what is not linear in them within their errors, of which a thousandth of an error is left here.

    Delays and phases are the same in all channels, amplitudes are each channel's own.
    """
    effects = [AMPLITUDES, DELAYS, COUPLING]
    first = files.result(0, name="gains", effects=effects)
    second, at_once = files.result(1, prior=first), files.result(0, 1, name="gains", effects=effects)
    assert_same(hb.load(second), hb.load(at_once), 2e-3)
    assert_same_effects(second, at_once, 2e-3)


def test_a_loop_goes_on_from_what_is_known(nights: Nights) -> None:
    """Gains and a source that the first night has found are nothing new in the second, and are known better."""
    prior, out = {"prior": {"file": str(nights.result)}}, nights.folder / "after"
    data = {"data": {"files": [str(nights.data("second"))]}}
    assert (
        main(["loop", str(write_job({**NIGHTS_JOB, **prior, **data}, nights.folder, "after.toml")), "-o", str(out)])
        == 0
    )
    found, before = hb.load(out), hb.load(nights.result)
    assert isinstance(found, hb.Found)
    assert found.rounds == []
    assert found.verdict == "consistent"
    assert found.content.effects is not None
    assert before.content.effects is not None
    for one, two in zip(found.content.effects["entries"], before.content.effects["entries"], strict=True):
        assert (one["settings"], one["names"], one["prior_std"]) == (two["settings"], two["names"], two["prior_std"])
        assert np.all(np.less(one["std"], two["std"]))
    assert main(["infer", str(out / "amended.toml"), "-o", str(nights.folder / "amended")]) == 0
    assert_same(hb.load(nights.folder / "amended"), found, 1e-6)
    assert_same_effects(nights.folder / "amended", out, 1e-6)


@pytest.mark.mpi
def test_any_number_of_ranks_says_the_same(comm: MPI.Comm, common_tmp_path: Path) -> None:
    """What all ranks infer from a second night after a first one, rank 0 does alone."""
    prior, jobs = common_tmp_path / "first", [common_tmp_path / f"job{number}.toml" for number in (0, 1)]
    if comm.rank == 0:
        for path, changes, before in zip(jobs, NIGHTS, ({}, {"file": str(prior)}), strict=False):
            data = {"simulate": {**JOB["data"]["simulate"], **changes, "n_times": 6}}
            write_job({**JOB, "data": data, "prior": before, "effects": [COUPLING]}, common_tmp_path, path.name)
    comm.Barrier()
    assert main(["infer", str(jobs[0]), "-o", str(prior)]) == 0
    assert main(["infer", str(jobs[1]), "-o", str(common_tmp_path / "all")]) == 0
    if comm.rank == 0:
        hb.infer(hb.Setup.from_job(jobs[1])).write(common_tmp_path / "alone")
        assert_same(hb.load(common_tmp_path / "all"), hb.load(common_tmp_path / "alone"), 1e-6)
        assert_same_effects(common_tmp_path / "all", common_tmp_path / "alone", 1e-6)


@pytest.mark.mpi
def test_a_prior_that_does_not_tell_of_its_data_is_refused_on_all_ranks(comm: MPI.Comm, common_tmp_path: Path) -> None:
    path, first = common_tmp_path / "job.toml", common_tmp_path / "first"
    if comm.rank == 0:
        data = {"simulate": {**JOB["data"]["simulate"], **NIGHTS[0], "n_times": 6}}
        write_job({**JOB, "data": data}, common_tmp_path, path.name)
    comm.Barrier()
    assert main(["infer", str(path), "-o", str(first)]) == 0
    content = read_inferred(first).content
    about = {key: value for key, value in content.provenance.items() if key != "integrations"}
    untold = Inferred.of(replace(content, provenance=about), first / "posterior.h5")
    data = [first / "data.uvh5"]
    with pytest.raises(InputError, match="does not tell which integrations") as caught:
        check_not_counted(comm, data, read_observation(data, Selection()), untold)
    assert caught.value.file == str(first / "posterior.h5")


def test_python_takes_a_result_from_memory_and_from_its_folder(files: Files) -> None:
    first = files.result(0)
    wanted = hb.load(files.result(1, prior=first))
    uvd, common = UVData.from_file(files.data(1)[0]), {"holdout": JOB["holdout"], "output": JOB["output"]}
    job = hb.load(first).job
    beam, sky = job.beam.model_dump(exclude_none=True), job.sky.model_dump(exclude_none=True)
    fresh = hb.infer(hb.Setup(files.data(0), beam=beam, sky=sky, basis=job.basis, seed=4, **common))
    for before in (fresh, hb.load(first)):
        found = hb.infer(hb.Setup(uvd, beam=beam, sky=sky, prior=before, seed=4, **common))
        assert_same(found, wanted, 1e-6)


def test_a_channel_by_itself_has_its_own_prior(files: Files) -> None:
    before, out = files.result(1, prior=files.result(0)), files.folder / "channel"
    assert main(["infer", str(files.job((2,), before, data={"freqs": [TWO[1]]})), "-o", str(out)]) == 0
    alone, wanted = hb.load(out).beam, hb.load(files.result(0, 1, 2)).beam
    np.testing.assert_allclose(alone.mean[0], wanted.mean[1], atol=1e-6 * wanted.std[1].min())


def damaged(folder: Path, into: Path, name: str) -> Path:
    """Copy a result and write over the middle of one of its files."""
    shutil.copytree(folder, into / "damaged")
    path = into / "damaged" / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 8] = b"\xff" * 8
    path.write_bytes(content)
    return into / "damaged"


def refused(
    files: Files, capfd: pytest.CaptureFixture[str], nights: tuple[int, ...], prior: Path, **tables: Any
) -> str:
    """Return the one line that says why."""
    capfd.readouterr()
    job = files.job(nights, prior, **tables)
    assert main(["infer", str(job), "-o", str(files.folder / "refused")]) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if "error" in line]
    assert len(lines) == 1
    assert not (files.folder / "refused").exists()
    return lines[0]


def test_no_data_count_twice(files: Files, capfd: pytest.CaptureFixture[str]) -> None:
    """Not even those of the result before the last one, in part, and saved in another way."""
    second = files.result(1, prior=files.result(0))
    copy = files.folder / "copy.uvh5"
    uvd = UVData.from_file(files.data(0)[0])
    uvd.select(times=np.unique(uvd.time_array)[2:7])
    uvd.conjugate_bls("ant2<ant1")
    uvd.reorder_blts("baseline")
    uvd.flag_array[:3] = True
    uvd.data_array = uvd.data_array.astype(np.complex64)
    uvd.write_uvh5(str(copy))
    for data, told in ((files.data(1)[0], "24 of 24"), (str(copy), "10 of 10")):
        said = refused(files, capfd, (), second, data={"files": [data]})
        twice = f"was made from the same data, {data}, which would count twice ({told} integrations); give data that"
        assert f"posterior.h5: {twice}" in said


def test_halves_of_a_file_count_once_each(files: Files) -> None:
    """What of a file no result was made from is new, and both halves together are the whole."""
    times = np.unique(UVData.from_file(files.data(0)[0], read_data=False).time_array)
    middle = float(times[5:7].mean())
    halves = [{"time_range": [float(times[0]) - 1, middle]}, {"time_range": [middle, float(times[-1]) + 1]}]
    none = {"kind": "none"}
    first = files.result(0, name="half", data=halves[0], holdout=none)
    both = hb.load(files.result(0, prior=first, data=halves[1], holdout=none))
    assert_same(both, hb.load(files.result(0, name="whole", holdout=none)), 1e-6)


def test_what_cannot_be_the_prior_is_refused(files: Files, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    first = files.result(0)
    said = refused(files, capfd, (1,), first, basis={**JOB["basis"], "n_modes": 23})
    assert "posterior.h5: basis: is of another basis than the job's: n_modes = 24; set the job's [basis] to" in said
    said = refused(files, capfd, (1,), files.folder / "night0")
    assert "[prior] file: is no result: no manifest.json lists posterior.h5 in it; name a folder written by" in said
    said = refused(files, capfd, (1,), damaged(first, tmp_path, "posterior.h5"))
    assert "posterior.h5" in said
    alone = files.folder / "alone"
    assert main(["infer", str(files.job((2,), data={"freqs": [TWO[0]]})), "-o", str(alone)]) == 0
    said = refused(files, capfd, (1,), alone)
    assert "[data] freqs: the result has no beam at" in said
