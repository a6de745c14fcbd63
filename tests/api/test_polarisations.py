"""Several polarisations in one job: each as in a job of its own, and what they have in common computed once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVBeam, UVData

import hydrabeam_mpi as hb
from hydrabeam_mpi.api.preparation import prepare_shared_each
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.rows import read_rows, read_rows_of_each
from hydrabeam_mpi.model.engines.gemm import GemmEngine
from hydrabeam_mpi.setup.job_file import load
from tests.api.test_other_feed import write_beams
from tests.loop.mock import FREQ, mock_job, write_job

BOTH = ["ee", "nn"]
N_TIMES = 12


def write_data(comm: MPI.Comm, folder: Path) -> None:
    """Simulate both polarisations, with other flags in either, and write a job of both and one of each.

    Collective: all ranks of ``comm``, which is the world's.
    """
    job = mock_job(basis={"n_modes": 40, "k_max": 16, "m_max": 4}, n_times=N_TIMES)
    job["beam"] = {"source": str(folder / "beams.beamfits")}
    if comm.rank == 0:
        write_beams(folder / "beams.beamfits")
        write_job({**job, "data": {**job["data"], "polarization": BOTH}}, folder, "simulated.toml")
    comm.Barrier()
    assert main(["simulate", str(folder / "simulated.toml"), "-o", str(folder / "made")]) == 0
    if comm.rank == 0:
        uvd = UVData.from_file(folder / "made" / "data.uvh5")
        crosses, rng = uvd.ant_1_array != uvd.ant_2_array, np.random.default_rng(3)
        uvd.flag_array[crosses] = rng.random(uvd.flag_array[crosses].shape) < [0.1, 0.3]
        uvd.write_uvh5(folder / "data.uvh5")
        for name, pol in {"both": BOTH, "ee": "ee", "nn": "nn"}.items():
            data = {"files": [str(folder / "data.uvh5")], "polarization": pol}
            write_job({**job, "data": data}, folder, f"{name}.toml")
    comm.Barrier()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data and jobs, and the results of all jobs."""
    folder = tmp_path_factory.mktemp("polarisations")
    write_data(MPI.COMM_WORLD, folder)
    for name in ("both", "ee", "nn"):
        assert main(["infer", str(folder / f"{name}.toml"), "-o", str(folder / name)]) == 0
    return folder


@pytest.mark.mpi
def test_each_is_as_in_a_job_of_its_own(comm: MPI.Comm, common_tmp_path: Path) -> None:
    write_data(comm, common_tmp_path)
    jobs = {name: common_tmp_path / f"{name}.toml" for name in ("both", *BOTH)}
    setups = {name: hb.Setup.from_job(path, comm) for name, path in jobs.items()}
    problems = prepare_shared_each(comm, setups["both"].job, None)
    for problem, rows in zip(problems, read_rows_of_each(problems, problems[0].train), strict=True):
        (pol,) = problem.observation.pols
        (alone,) = prepare_shared_each(comm, setups[pol].job, None)
        expected = read_rows(alone, alone.train)
        for name in ("data", "inv_noise_var", "groups", "member", "n_unflagged"):
            np.testing.assert_array_equal(getattr(rows, name), getattr(expected, name))
        np.testing.assert_array_equal(problem.priors[0].mean, alone.priors[0].mean)
    together, alone_of = hb.infer(setups["both"]), {pol: hb.infer(setups[pol]) for pol in BOTH}
    assert together.polarizations == tuple(BOTH)
    if comm.rank:
        return
    for pol in BOTH:
        one, other = together[pol].beam, alone_of[pol].beam
        assert one.polarization == pol
        assert np.all(np.abs(one.mean - other.mean) < 1e-9 * other.std)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=0, atol=1e-9 * other.std.min() ** 2)
        for name in ("n_data", "heldout_n"):
            assert together[pol].summary[name] == alone_of[pol].summary[name]
        for name in ("heldout_chi2_predictive", "log_evidence"):
            np.testing.assert_allclose(together[pol].summary[name], alone_of[pol].summary[name], rtol=1e-9)
        assert together[pol].job == setups[pol].job
    assert together["ee"].summary["n_data"] != together["nn"].summary["n_data"]


def test_folders_are_results(folder: Path) -> None:
    result, alone = hb.load(folder / "both"), hb.load(folder / "nn")
    assert isinstance(result, hb.Results)
    assert (result.polarizations, alone.polarizations) == (("ee", "nn"), ("nn",))
    assert alone["nn"] is alone
    np.testing.assert_array_equal(result["nn"].beam.mean, hb.load(folder / "both" / "nn").beam.mean)
    assert result["nn"].job == alone.job
    told = json.loads((folder / "both" / "summary.json").read_text())
    assert told["polarizations"] == result.summary["polarizations"]
    assert told["polarizations"]["nn"]["n_data"] == alone.summary["n_data"]
    uvbeam = UVBeam.from_file(folder / "both" / "beam.beamfits")
    assert uvbeam.polarization_array.tolist() == [-5, -6]
    for number, pol in enumerate(BOTH):
        own = UVBeam.from_file(folder / "both" / pol / "beam.beamfits")
        np.testing.assert_array_equal(uvbeam.data_array[0, number], own.data_array[0, 0])
    with pytest.raises(InputError, match="is of ee and nn"):
        _ = result.beam


@pytest.mark.study
def test_they_are_used_as_any_result(folder: Path, tmp_path: Path) -> None:
    assert main(["predict", str(folder / "both" / "nn"), str(folder / "nn.toml"), "-o", str(tmp_path / "p")]) == 0
    assert main(["report", str(folder / "both")]) == 0
    assert all((folder / "both" / pol / "report.html").exists() for pol in BOTH)
    # A report belongs to the result, also to the one around it.
    assert main(["infer", str(folder / "both.toml"), "-o", str(folder / "both"), "--overwrite"]) == 0
    assert not (folder / "both" / "nn" / "report.html").exists()
    (folder / "both" / "nn" / "notes.txt").write_text("mine")
    assert main(["infer", str(folder / "both.toml"), "-o", str(folder / "both"), "--overwrite"]) == 2
    (folder / "both" / "nn" / "notes.txt").unlink()


def test_written_from_python(folder: Path, tmp_path: Path) -> None:
    result = hb.infer(hb.Setup.from_job(folder / "both.toml"))
    result.write(tmp_path / "out")
    names = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert names == {
        str(path.relative_to(folder / "both"))
        for path in (folder / "both").rglob("*")
        if path.is_file() and "report" not in path.name and "figures" not in path.parts
    }
    again = hb.load(tmp_path / "out")
    again.write(tmp_path / "again")
    np.testing.assert_array_equal(hb.load(tmp_path / "again")["ee"].beam.covariance, result["ee"].beam.covariance)


def test_the_design_is_computed_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    computed, design = [], GemmEngine.design

    def counted(engine: GemmEngine, basis: Any, *args: Any) -> Any:
        computed.append(basis.n_columns)
        return design(engine, basis, *args)

    monkeypatch.setattr(GemmEngine, "design", counted)
    of_bases = {}
    for name in ("both", "nn"):
        computed.clear()
        hb.infer(hb.Setup.from_job(folder / f"{name}.toml"))
        # Given beams have two columns, their real and imaginary parts.
        of_bases[name] = [n for n in computed if n > 2]
    # Modes of a beam and of the same one turned are the same.
    assert of_bases == dict.fromkeys(("both", "nn"), N_TIMES * [40])


@pytest.mark.parametrize(
    "command", ["loop {job} -o {out}", "sample {job} -o {out}", "plan {job}", "infer {job} -o {out} --dry-run"]
)
def test_commands_that_take_one_say_so(
    folder: Path, tmp_path: Path, command: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(command.format(job=folder / "both.toml", out=tmp_path / "out").split()) == 2
    (line,) = capfd.readouterr().err.strip().splitlines()
    assert f"{folder / 'both.toml'}: [data] polarization: has 2 polarisations" in line
    assert line.endswith('; set polarization = "ee"')


def test_api_that_takes_one_says_so(folder: Path, tmp_path: Path) -> None:
    setup = hb.Setup.from_job(folder / "both.toml")
    for wrong in (hb.close_loop, hb.plan, lambda one: hb.sample(one, tmp_path / "chains")):
        with pytest.raises(InputError, match="has 2 polarisations, and this takes one") as caught:
            wrong(setup)
        assert caught.value.field == "[data] polarization"


def refused(folder: Path, capfd: pytest.CaptureFixture[str], *arguments: str, **changes: Any) -> str:
    """Return what is told of a job that is the one of both but for some changes."""
    job = {**mock_job(), "data": {"files": [str(folder / "data.uvh5")], "polarization": BOTH}, **changes}
    path = write_job(job, folder, "wrong.toml")
    assert main([*(arguments or ("infer",)), str(path), "-o", str(folder / "none")]) == 2
    return capfd.readouterr().err.strip().splitlines()[-1]


def test_what_is_of_one_is_refused(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    told = refused(folder, capfd, effects=[{"kind": "outliers"}])
    assert "wrong.toml: [data] polarization: has 2 polarisations, and effects ([[effects]]) is of one" in told
    told = refused(folder, capfd, prior={"file": str(folder / "ee")})
    assert "a prior from a file ([prior] file) is of one" in told
    told = refused(folder, capfd, prior={"file": str(folder / "both")}, data={"files": [str(folder / "data.uvh5")]})
    assert f"[prior] file: has results of ee, nn; name {folder / 'both' / 'ee'} or" in told
    told = refused(folder, capfd, data={"files": [str(folder / "data.uvh5")], "polarization": ["ee", "xx"]})
    assert "[data] polarization: ee and xx are 1 of the data; name each once" in told
    told = refused(folder, capfd, data={"files": [str(folder / "data.uvh5")], "polarization": ["ee", "ee"]})
    assert "it should be a list that names each value once" in told
    told = refused(folder, capfd, "predict", str(folder / "both"))
    assert f"{folder / 'both'}: has results of ee, nn; name" in told


def test_a_channel_that_one_lacks_is_left_out_of_both(folder: Path, tmp_path: Path) -> None:
    uvd = UVData.from_file(folder / "data.uvh5")
    other = uvd.copy()
    other.freq_array = uvd.freq_array + 1e6
    other.flag_array[..., 1] = True
    other.write_uvh5(tmp_path / "other.uvh5")
    files = [str(folder / "data.uvh5"), str(tmp_path / "other.uvh5")]
    job = mock_job()
    path = write_job({**job, "data": {"files": files, "polarization": BOTH}}, tmp_path)
    (ee, nn) = prepare_shared_each(MPI.COMM_SELF, load(MPI.COMM_SELF, path, takes_several=True), None)
    assert ee.observation.freqs.tolist() == nn.observation.freqs.tolist() == [FREQ]
    assert any("of which all data of ee or nn are flagged: 132 MHz" in line for line in ee.cautions)


@pytest.mark.parametrize(
    "changes",
    [{"solver": {"precision": "mixed"}}, {"prior": {"frequency": {"kind": "modes", "n_modes": 1}}}],
    ids=["mixed precision", "over frequency"],
)
def test_other_ways_to_solve(folder: Path, tmp_path: Path, changes: dict[str, Any]) -> None:
    job = mock_job(basis={"n_modes": 40, "k_max": 16, "m_max": 4}, freqs=(FREQ, FREQ + 5e4))
    job |= {"beam": {"source": str(folder / "beams.beamfits")}, "noise": {"kind": "constant", "sigma": 0.1}, **changes}
    made = {**job["data"]["simulate"], "noise": False}
    paths = [
        write_job({**job, "data": {"simulate": made, "polarization": pol}}, tmp_path, f"{name}.toml")
        for name, pol in {"both": BOTH, "nn": "nn"}.items()
    ]
    both, alone = (hb.infer(hb.Setup.from_job(path)) for path in paths)
    np.testing.assert_allclose(both["nn"].beam.std, alone.beam.std, rtol=1e-6)
    assert np.all(np.abs(both["nn"].beam.mean - alone.beam.mean) < 1e-4 * alone.beam.std)
    for told in ("rounding_shift", "over_frequency"):
        assert (told in both["nn"].summary) == (told in alone.summary)


def test_simulated_together(folder: Path, tmp_path: Path) -> None:
    """The first is as in a job of its own; of cross-polarised ones the feeds' autocorrelations come along."""
    job = mock_job()
    for name, pol in {"several": ["ee", "nn"], "one": "ee", "crossed": "en"}.items():
        path = write_job({**job, "data": {**job["data"], "polarization": pol}}, tmp_path, f"{name}.toml")
        assert main(["simulate", str(path), "-o", str(tmp_path / name)]) == 0
    several, one, crossed = (UVData.from_file(tmp_path / name / "data.uvh5") for name in ("several", "one", "crossed"))
    assert several.get_pols() == ["ee", "nn"]
    np.testing.assert_array_equal(several.data_array[..., 0], one.data_array[..., 0])
    assert np.abs(several.data_array[..., 1] - several.data_array[..., 0]).max() > 0
    assert sorted(crossed.get_pols()) == ["ee", "en", "nn"]
    assert UVBeam.from_file(tmp_path / "crossed" / "true_beam.beamfits").polarization_array.tolist() == [-5, -6, -7]
    assert hb.load_truth(tmp_path / "several" / "truth-nn.h5").polarization == "nn"
    with pytest.raises(InputError, match="takes one at a time"):
        hb.simulate(tmp_path / "several.toml")


def test_effects_are_simulated_in_one(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    job = mock_job({"kind": "antenna_gains"})
    path = write_job({**job, "data": {**job["data"], "polarization": BOTH}}, tmp_path)
    assert main(["simulate", str(path), "-o", str(tmp_path / "out")]) == 2
    told = capfd.readouterr().err
    assert (
        'job.toml: [data] polarization: has 2 polarisations, and effects are simulated in one; set it to "ee"' in told
    )


@pytest.mark.mpi
def test_rows_of_either_kind_share_the_design(comm: MPI.Comm, common_tmp_path: Path) -> None:
    """Of an array in which some baselines are others reversed, which cross-polarised data keep apart."""
    basis = {"n_modes": 30, "k_max": 10, "m_max": 2, "form": "complex"}
    job = mock_job(basis=basis, noise={"kind": "constant", "sigma": 0.1})
    layout = "0 0 0\n30 0 0\n15 5 0\n30 20 0\n45 5 0\n0 20 0\n0 60 0\n"
    made = {**job["data"]["simulate"], "noise": False, "array": {"file": str(common_tmp_path / "array.txt")}}
    pols = {"both": ["en", "ee"], "en": "en", "ee": "ee"}
    if comm.rank == 0:
        (common_tmp_path / "array.txt").write_text(layout)
        for name, pol in pols.items():
            data = {"simulate": made, "polarization": pol}
            write_job({**job, "data": data}, common_tmp_path, f"{name}.toml")
    comm.Barrier()
    both, *alone = (hb.infer(hb.Setup.from_job(common_tmp_path / f"{name}.toml", comm)) for name in pols)
    if comm.rank:
        return
    for one in alone:
        (pol,) = one.polarizations
        assert np.all(np.abs(both[pol].beam.mean - one.beam.mean) < 1e-9 * one.beam.std)
        assert both[pol].summary["n_unique_baselines"] == one.summary["n_unique_baselines"]
    assert both["en"].summary["n_unique_baselines"] > both["ee"].summary["n_unique_baselines"]
