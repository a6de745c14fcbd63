"""What a plan says of small jobs, from Python and on the command line."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import hydrabeam_mpi as hb
from hydrabeam_mpi.api.plan import possible
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.fit.memory import Share, check_fits, inference_bytes, joint_bytes
from hydrabeam_mpi.fit.room import SKIES_ELSEWHERE, Room
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.loop.memory import candidates_of, further_bytes, loop_bytes, weighing_bytes
from hydrabeam_mpi.memory import machine_bytes
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.planning.coupled import SolvedTogether
from hydrabeam_mpi.planning.measure import Bench, Cost
from hydrabeam_mpi.planning.network import TYPICAL, measure_network
from hydrabeam_mpi.planning.outline import outline
from hydrabeam_mpi.planning.probe import departing, probe
from hydrabeam_mpi.planning.table import as_text
from hydrabeam_mpi.planning.told import Forecast
from hydrabeam_mpi.setup.given import Given

JOB = """
seed = 5
[data.simulate]
array = { hex = [2, 3] }
n_times = 6
freqs = ["130 MHz", "131 MHz", "132 MHz"]
[sky]
n_sources = 100
[beam]
frequency = "scale"
[basis]
n_modes = 30
k_max = 8
m_max = 3
[output]
draws = 3
"""

EFFECTS = """
[loop]
effects = ["antenna_gains", "basis_truncation"]
"""


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "job.toml"
    path.write_text(JOB)
    return path


@pytest.fixture(scope="module")
def made(job: Path) -> hb.Plan:
    return hb.plan(hb.Setup.from_job(job), ranks=(1, 2, 12), commands=("simulate", "infer"))


def test_work_is_shared_out_as_in_the_run(made: hb.Plan) -> None:
    parts = [one.partition for one in made.forecasts if one.command == "infer"]
    assert [(one.groups, one.ranks_per_group, one.channels, one.times) for one in parts] == [
        (1, 1, 3, 3),
        (2, 1, 2, 3),
        (3, 4, 1, 1),
    ]
    # A simulation has all times, and shares out nothing else.
    parts = [one.partition for one in made.forecasts if one.command == "simulate"]
    assert [(one.groups, one.ranks_per_group, one.channels, one.times) for one in parts] == [
        (1, 1, 3, 6),
        (1, 2, 3, 3),
        (1, 12, 3, 1),
    ]


def test_more_ranks_take_less_each(made: hb.Plan) -> None:
    one, _, twelve = (forecast for forecast in made.forecasts if forecast.command == "infer")
    assert twelve.phases_s["design"] < one.phases_s["design"]
    assert twelve.phases_s["prepare"] == one.phases_s["prepare"]
    assert one.sent_bytes == 0 < twelve.sent_bytes
    assert 50e6 < twelve.memory_bytes <= one.memory_bytes


def test_files_have_the_size_that_is_forecast(made: hb.Plan, job: Path, tmp_path: Path) -> None:
    assert main(["infer", str(job), "-o", str(tmp_path / "out")]) == 0
    (forecast,) = (one for one in made.forecasts if (one.command, one.ranks) == ("infer", 1))
    written = sum(path.stat().st_size for path in (tmp_path / "out").glob("*.h5"))
    assert forecast.file_bytes == pytest.approx(written, rel=0.25)


def test_command(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(job), "--ranks", "1,3", "--commands", "simulate", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [(one["command"], one["ranks"]) for one in told["forecasts"]] == [("simulate", 1), ("simulate", 3)]
    assert all(one["wall_s"] == sum(one["phases_s"].values()) > 0 for one in told["forecasts"])


def test_unknown_command(job: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(job), "--commands", "infers"]) == 2
    assert "'infers' is no command that this job can be given to; choose of" in capfd.readouterr().err


def test_table_has_a_line_a_forecast(made: hb.Plan) -> None:
    lines = str(made).splitlines()
    assert lines[0].startswith("command")
    assert [line.split()[:2] for line in lines[1:7]] == [
        [command, ranks] for command in ("simulate", "infer") for ranks in ("1", "2", "12")
    ]
    assert any("assumed; start under mpiexec to measure them" in line for line in lines[7:])
    assert not any(line.startswith("loop:") for line in lines)


def test_cost_goes_through_what_was_measured() -> None:
    cost = Cost(0.5, 0.02, 0.003)
    sizes = [(1.0, 10.0), (1.0, 40.0), (4.0, 40.0)]
    found = Cost.through(sizes, [cost.seconds(*size) for size in sizes])
    assert found.seconds(30.0, 63.0) == pytest.approx(cost.seconds(30.0, 63.0))


def test_what_is_decided_once_is_told_from_what_each_channel_takes() -> None:
    measured = Cost(0.5, 0.02, 0.003)
    one = measured.seconds(4.0, 40.0)
    assert measured.told_once(one, 2 * one) == measured
    shared = measured.told_once(one, 2 * one - 0.3)
    assert shared.once == pytest.approx(0.3)
    assert shared.seconds(4.0, 40.0) == pytest.approx(one)
    assert shared.seconds(4.0, 40.0, channels=4) == pytest.approx(4 * one - 3 * 0.3)
    # Noise of the clock: what rows take is taken by each channel, and none takes less than its rows.
    assert measured.told_once(one, 0.5 * one).once == 0.5
    assert measured.told_once(one, 3 * one).once == 0.0


def test_noise_of_the_clock_gives_no_negative_cost() -> None:
    cost = Cost.through([(1.0, 10.0), (1.0, 40.0), (4.0, 40.0)], [0.02, 0.01, 0.005])
    assert min(vars(cost).values()) >= 0


def test_memory_grows_with_what_is_held() -> None:
    basis = Zernike(6)
    small, large = (Share(1, n, n, 100, 50, 1000, basis) for n in (10, 1000))
    assert inference_bytes(small, root=False) <= inference_bytes(small, root=True) < inference_bytes(large, root=True)
    assert joint_bytes(large, root=True) > inference_bytes(large, root=True) > large.kept


def test_memory_counts_what_is_kept_for_rounding_and_solved_for_together() -> None:
    plain = Share(1, 10, 10, 100, 50, 1000, Zernike(6))
    watching, together = replace(plain, watched_times=2), replace(plain, unknowns=10_000)
    assert inference_bytes(watching, root=False) >= inference_bytes(plain, root=False) + 2 * plain.design
    assert inference_bytes(together, root=True) > 2 * 8 * 10_000**2


def test_what_does_not_fit_is_refused_in_one_line() -> None:
    check_fits(10**9, 10**9, 4)
    with pytest.raises(hb.InputError) as raised:
        check_fits(5 * 10**9, 2 * 10**9, 4)
    assert str(raised.value).startswith("needs 5 GB a rank on 4 ranks, and a rank has 2 GB; use more nodes")
    with pytest.raises(hb.InputError, match=r"needs 5 GB a rank on 1 rank, .* solver = \"conjugate-gradients\""):
        check_fits(5 * 10**9, 2 * 10**9, 1, as_one=True)


def test_loop_tells_what_is_certain_from_what_each_effect_takes(tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    path.write_text(JOB.replace('freqs = ["130 MHz", "131 MHz", "132 MHz"]', 'freqs = ["130 MHz"]') + EFFECTS)
    one, two = (hb.plan(hb.Setup.from_job(path), commands=("loop",), found=found).forecasts[0] for found in (0, 2))
    assert {"conventions", "fit", "attribution", "prior", "settle"} <= set(one.phases_s)
    assert "rounds" not in one.phases_s
    assert two.phases_s["rounds"] == pytest.approx(2 * two.round_s)
    assert two.round_s > two.phases_s["attribution"]
    assert one.memory_bytes == pytest.approx(two.memory_bytes, rel=0.2)
    assert one.further_bytes > 0
    assert one.anew_s > 0
    assert "where the prior gets other widths in the end" in as_text([one], [])
    assert one.fits
    assert "DOES NOT FIT" not in as_text([one], [])
    large = replace(one, available_bytes=one.memory_bytes - 1)
    assert not large.fits
    assert "loop on 1 rank DOES NOT FIT machines like this one: it needs" in as_text([large], [])


@pytest.mark.study
def test_loop_of_several_channels(job: Path) -> None:
    """Of three channels two are timed; a loop begins anew where their beams may be off alike."""
    problem = outline(load_job(job), Given(), time.process_time)
    pair = problem.pair
    assert pair is not None
    assert list(pair.observation.freqs) == [130e6, 131e6]
    assert len(pair.priors) == 2
    (found,) = hb.plan(hb.Setup.from_job(with_effects(job)), commands=("loop",), found=1).forecasts
    assert found.phases_s["rounds"] == found.round_s > 0
    assert found.anew_s > 0
    alone = with_effects(job, 'skip = ["common_beam"]\n')
    (found,) = hb.plan(hb.Setup.from_job(alone), commands=("loop",), found=1).forecasts
    assert found.anew_s == 0.0


@pytest.mark.study
def test_all_effects_of_several_channels_are_counted(job: Path) -> None:
    """Those that are looked for as the beam of the middle channel sees the sky, too, of which one alone is prepared."""
    path = job.parent / "all.toml"
    path.write_text(job.read_text())
    (found,) = hb.plan(hb.Setup.from_job(path), commands=("loop",), found=0).forecasts
    assert found.phases_s["attribution"] > 0


def with_effects(job: Path, more: str = "") -> Path:
    path = job.parent / "loop.toml"
    path.write_text(job.read_text() + EFFECTS + more)
    return path


def test_rows_that_are_timed(job: Path) -> None:
    """All times of a small array; nothing but the beam departs from the model, unless one antenna is to be found."""
    problem = outline(load_job(job), Given(), time.process_time)
    sizes = Bench(problem, time.process_time).sizes
    assert sizes[-1] == (3, problem.problem.redundant.Ngroups)
    signal = [
        probe(problem.problem, *sizes[-1], beams, faulty=False).train.rows
        for beams in (None, departing(problem.problem))
    ]
    one_wrong = probe(problem.problem, *sizes[-1]).train.rows
    model = problem.problem.forward_model(signal[0].groups).visibilities(problem.problem.beams, signal[0].tile.times)
    of_rows = model[:, :, signal[0].member]

    def chi2(rows: Rows) -> float:
        return float(np.mean(np.abs(rows.data - of_rows) ** 2 * rows.inv_noise_var))

    assert chi2(signal[0]) == pytest.approx(1.0, abs=0.3)
    assert min(chi2(signal[1]), chi2(one_wrong)) > 10


def test_columns_are_as_many_as_the_effects_have(job: Path) -> None:
    problem = outline(load_job(job), Given(), time.process_time).problem
    found, n_antennas = candidates_of(problem), problem.observation.Nants
    assert 2 * n_antennas in found.weighed  # gains
    assert 6 * n_antennas in found.weighed  # shapes of single beams
    assert found.more == problem.basis.n_modes + 1  # as many functions as it has, and the rest of the model beam
    assert found.by_group <= max(found.weighed.max(), found.again.max())
    small, large = (Share(1, n, n, 100, 50, 1000, problem.basis) for n in (10, 1000))
    assert 0 < weighing_bytes(found, small) < weighing_bytes(found, large)
    assert 0 < further_bytes(found, small) < further_bytes(found, large)


def test_what_has_no_room_is_made_anew_and_not_counted() -> None:
    assert Room.of(10, 50, 1, 30, 1000, np.inf) == Room(True, True, True, SKIES_ELSEWHERE)
    assert Room.of(10, 50, 1, 30, 1000, 0.0) == Room(False, False, False, 0)
    # Fringes of one sky, and of not so many: a quarter is theirs together.
    fringes = 8 * 1000 * 10 * 50
    assert Room.of(10, 50, 1, 30, 1000, 8 * fringes) == Room(True, True, True, 0)
    assert Room.of(10, 50, 1, 30, 1000, 4 * (1 + SKIES_ELSEWHERE) * fringes).skies_elsewhere == SKIES_ELSEWHERE
    keeping = Share(1, 1000, 1000, 100, 50, 1000, Zernike(6))
    making = replace(keeping, kept_bytes=0.0)
    assert keeping.kept_designs == 2000 * keeping.design
    assert making.kept_designs == making.kept_waves == 0
    assert joint_bytes(making, root=True) < joint_bytes(keeping, root=True)


def test_loop_that_does_not_fit_is_refused(job: Path) -> None:
    """By the bytes of its rows: a rank has the rows of a day of full HERA here, and no machine's memory."""
    problem = outline(load_job(job), Given(), time.process_time).problem
    share = Share(1, 10**6, 10**6, 61_075, 8_009, 1000, problem.basis, kept_bytes=0.0)
    with pytest.raises(hb.InputError, match="TB a rank on 1 rank, and a rank has"):
        check_fits(loop_bytes(problem, share, True), machine_bytes(), 1)


@pytest.mark.mpi
def test_messages_are_timed_where_there_are_ranks(comm: MPI.Comm) -> None:
    network = measure_network(comm)
    assert network.measured == (comm.size > 1)
    assert network.alpha > 0
    assert network.allreduce(8_000_000, 1) == 0 < network.allreduce(8_000_000, 64)
    assert TYPICAL.allreduce(8, 4096) > TYPICAL.allreduce(8, 64)


def test_channels_that_hang_together(job: Path, tmp_path: Path) -> None:
    """Rank 0 solves for all of them, and for each length once more than for one; other steps are as they were."""

    def forecasts(frequency: str) -> dict[str, Forecast]:
        path = tmp_path / "job.toml"
        path.write_text(job.read_text() + f"[prior.frequency]\n{frequency}\n")
        found = hb.plan(hb.Setup.from_job(path), ranks=(1,), commands=("infer",)).forecasts
        return {one.command: one for one in found}

    alone, two, many = (
        forecasts(f"kind = '{kind}'")["infer"]
        for kind in ("independent", "modes'\nn_modes = 2\nsolver = 'dense", "gaussian-process'\nsolver = 'dense")
    )
    assert "together" not in alone.phases_s
    assert min(two.phases_s["together"], many.phases_s["together"]) > 0
    assert (SolvedTogether(1.0, 2.0, 1).inference_s, SolvedTogether(1.0, 2.0, 8).inference_s) == (3.0, 11.0)
    assert alone.file_bytes < two.file_bytes == many.file_bytes
    with pytest.raises(hb.InputError, match="how many steps conjugate gradients take"):
        forecasts("kind = 'modes'\nn_modes = 2\nsolver = 'conjugate-gradients'")
    assert possible(load_job(tmp_path / "job.toml")) == ["simulate", "infer", "loop", "sample"]
    assert possible(many_lengths(job, tmp_path)) == ["simulate", "infer"]


def many_lengths(job: Path, folder: Path) -> Job:
    (folder / "many.toml").write_text(job.read_text() + "[prior.frequency]\nkind = 'gaussian-process'\n")
    return load_job(folder / "many.toml")
