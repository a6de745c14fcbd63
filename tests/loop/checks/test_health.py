"""What is wrong with data themselves is named, put aside and told; effects and healthy data are let alone."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVData

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.robust import LOG_STD, outliers
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.loop.checks.bad_ends import by_antenna
from hydrabeam_mpi.loop.checks.brightest import brightest_source
from hydrabeam_mpi.loop.checks.health import check_health
from hydrabeam_mpi.loop.checks.health_sums import Excess, Sums, read_sample
from hydrabeam_mpi.loop.checks.scale import flux_scale
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.setup.findings import Finding, mended_job
from hydrabeam_mpi.setup.problem import estimate_noise, prepare
from hydrabeam_mpi.simulation.mock import simulate_to
from tests.loop.mock import mock_job, write_job

N_TIMES = 24
CLOSE = [6.0, 6.0 + N_TIMES * 10 / 3600]
"""Sidereal hours, so that integrations follow each other."""
Change = Callable[[UVData], None]


def made(folder: Path, *injected: dict[str, Any], seed: int = 4, close: bool = True, **array: Any) -> dict[str, Any]:
    """Simulate ``data.uvh5`` in two channels and return a job that reads it."""
    job = mock_job(*injected, n_times=N_TIMES, freqs=(131e6, 133e6))
    job["data"]["simulate"]["array"].update(array)
    job["seed"] = seed
    if close:
        job["data"]["simulate"]["lst_range"] = CLOSE
    simulate_to(MPI.COMM_SELF, load_job(write_job(job, folder)), folder)
    job["data"] = {"files": ["data.uvh5"]}
    return job


def damaged(folder: Path, change: Change) -> list[str]:
    """Write a damaged copy and return it as a job names it."""
    with quiet():
        uv = UVData.from_file(folder / "data.uvh5")
        change(uv)
        uv.write_uvh5(folder / "damaged.uvh5", clobber=True, run_check=False)
    return ["damaged.uvh5"]


def found(job: dict[str, Any], folder: Path, world: MPI.Comm = MPI.COMM_SELF, **data: Any) -> list[Finding]:
    job = {**job, "data": {**job["data"], **data}}
    if world.rank == 0:
        write_job(job, folder)
    world.Barrier()
    problem = prepare(load_job(folder / "job.toml"), tuple(folder / name for name in job["data"]["files"]))
    problem = estimate_noise(world, problem)
    return check_health(ProcessGrid.split(world, problem.observation.Nfreqs), problem)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("good")


@pytest.fixture(scope="module")
def job(folder: Path) -> dict[str, Any]:
    return made(folder)


def crosses(uv: UVData) -> np.ndarray:
    return uv.ant_1_array != uv.ant_2_array


def of_antenna(uv: UVData, number: int) -> np.ndarray:
    return (uv.ant_1_array == number) | (uv.ant_2_array == number)


def at_times(uv: UVData, *numbers: int) -> np.ndarray:
    return np.isin(uv.time_array, np.unique(uv.time_array)[list(numbers)])


def noisy(uv: UVData, rows: np.ndarray, sigma: float = 20.0) -> None:
    """Add noise of so many Jy."""
    rng = np.random.default_rng(1)
    shape = uv.data_array[rows].shape
    uv.data_array[rows] += sigma * (rng.normal(size=shape) + 1j * rng.normal(size=shape))


@pytest.mark.parametrize(("seed", "close"), [(1, True), (2, True), (3, True), (1, False), (2, False), (3, False)])
def test_healthy_data(seed: int, close: bool, tmp_path: Path) -> None:
    assert found(made(tmp_path, seed=seed, close=close), tmp_path) == []


@pytest.mark.parametrize(
    ("kind", "strength"),
    [("antenna_gains", 0.5), ("cross_coupling", 3.0), ("missing_sources", 200.0), ("outliers", 30.0), ("diffuse", 3.0)],
)
def test_effects_are_left_to_the_loop(kind: str, strength: float, tmp_path: Path) -> None:
    """Gains wrong by half, couplings and sources as strong as the sky: gross, and yet effects."""
    for close in (True, False):
        assert found(made(tmp_path, {"kind": kind, "strength": strength}, close=close), tmp_path) == []


def test_redundant_partners_with_other_gains_differ_by_most_where_the_sky_is_brightest(
    job: dict[str, Any], folder: Path
) -> None:
    """That is no bad integration; one in which they differ out of proportion to what they see is."""
    problem = prepare(load_job(write_job(job, folder)), (folder / "data.uvh5",))
    problem = estimate_noise(MPI.COMM_SELF, problem)
    grid = ProcessGrid.split(MPI.COMM_SELF, problem.observation.Nfreqs)
    sample, rng = read_sample(grid, problem), np.random.default_rng(2)
    sky = 50 + 2000 * np.exp(-0.5 * (np.arange(N_TIMES) - 9.0) ** 2)
    gains = 1 + 0.1 * rng.normal(size=len(sample.bls))
    noise = rng.normal(size=(2, *sample.data.shape))
    spoilt = np.where(np.arange(N_TIMES) == 17, 300.0, 0.0)[:, np.newaxis] * rng.normal(size=len(sample.bls))
    for added, bad in ((0.0, []), (spoilt, [17])):
        data = sky[:, np.newaxis] * gains + added + noise[0] + 1j * noise[1]
        looked = replace(sample, data=data, weights=np.full(data.shape, 0.5))
        total, n = Excess.of_partners(grid, problem, looked, looked.weights).times
        assert np.flatnonzero(outliers(total / n, LOG_STD / np.sqrt(n)) > 0).tolist() == bad


@pytest.mark.parametrize(("scale", "with_phases"), [(1.5e-4, False), (1.5e-4, True), (40.0, False)])
def test_raw_data(job: dict[str, Any], folder: Path, scale: float, with_phases: bool) -> None:
    """Nothing calibrates them: gains of 0.0122, and every antenna with a phase of its own.

    Data that are larger, and else the model's, lack no source.
    """

    def uncalibrate(uv: UVData) -> None:
        phases = np.random.default_rng(1).uniform(0, 2 * np.pi, 100) * with_phases
        gain = np.sqrt(scale) * np.exp(1j * phases)
        uv.data_array *= (gain[uv.ant_1_array] * gain[uv.ant_2_array].conj())[:, None, None]

    (one,) = found(job, folder, files=damaged(folder, uncalibrate))
    assert one.what == "a wrong flux scale"
    assert one.flux_scale == pytest.approx((1 / scale,), rel=0.1)
    assert f"flux_scale = {one.flux_scale[0]:.5g}" in one.remedy
    # As the remedy says.
    assert found(job, folder, files=["damaged.uvh5"], flux_scale=one.flux_scale[0]) == []


def test_data_that_are_larger_may_be_a_sky_that_the_model_lacks(job: dict[str, Any], folder: Path) -> None:
    """As long as they are not the model's but for a scale."""

    def brighter(uv: UVData) -> None:
        uv.data_array *= 40 * np.exp(1j * uv.uvw_array[:, :1])[:, np.newaxis]

    assert found(job, folder, files=damaged(folder, brighter)) == []


@pytest.mark.parametrize(("power", "is_wrong"), [(1.0, False), (1e-3, True)])
def test_data_as_large_as_the_model_that_hardly_follow_it_are_not_on_another_scale(
    power: float, is_wrong: bool, job: dict[str, Any], folder: Path
) -> None:
    """As conjugated data, which with little noise are like the model by chance: conventions have their own check."""
    problem = prepare(load_job(write_job(job, folder)), (folder / "data.uvh5",))
    grid = ProcessGrid.split(MPI.COMM_SELF, problem.observation.Nfreqs)
    sample = read_sample(grid, problem)
    sums = Sums.of(grid, problem, sample, sample.weights)
    model = 1e6 * np.ones_like(sums.bl_products[1])
    alike = 0.02 * model * np.exp(0.1j * np.arange(model.shape[1]))
    findings = flux_scale(problem, replace(sums, bl_products=np.stack([alike, model, power * model])))
    assert [one.what for one in findings] == ["a wrong flux scale"] * is_wrong


@pytest.mark.parametrize("scales", [(1.5e-4, 3e-4), (1.0, 1e3)])
def test_channels_on_scales_of_their_own(scales: tuple[float, float], job: dict[str, Any], folder: Path) -> None:
    """Each gets its own; one that is calibrated stays as it is. The amended job says so, too."""

    def uncalibrate(uv: UVData) -> None:
        uv.data_array *= np.array(scales)[:, None]

    (one,) = found(job, folder, files=damaged(folder, uncalibrate))
    assert one.what == "a wrong flux scale"
    assert one.flux_scale == pytest.approx(1 / np.array(scales), rel=0.2)  # as baselines differ
    assert (one.flux_scale[0] == 1) == (scales[0] == 1)
    assert one.where == ("all data" if scales[0] != 1 else "channels at 133 MHz")
    mended = mended_job(load_job(folder / "job.toml"), [one]).data.flux_scale
    assert mended == one.flux_scale
    assert f"flux_scale = {list(one.flux_scale)} in [data]" in one.remedy
    assert found(job, folder, files=["damaged.uvh5"], flux_scale=list(one.flux_scale)) == []
    with pytest.raises(InputError, match=r"flux_scale: has 3 numbers, and there are 2 channels; give one number"):
        found(job, folder, files=["damaged.uvh5"], flux_scale=[1.0, 2.0, 3.0])


def test_scales_that_conventions_and_beams_explain(job: dict[str, Any], folder: Path) -> None:
    for factor in (0.5, 2.0):
        assert found(job, folder, files=damaged(folder, lambda uv, factor=factor: uv.data_array.__imul__(factor))) == []


def weak_autos(uv: UVData) -> None:
    uv.data_array[~crosses(uv) & of_antenna(uv, 3)] *= 1e-9


def no_autos(uv: UVData) -> None:
    uv.data_array[~crosses(uv) & of_antenna(uv, 3)] = 0


def all_zero(uv: UVData) -> None:
    uv.data_array[crosses(uv) & of_antenna(uv, 3)] = 0


def all_constant(uv: UVData) -> None:
    uv.data_array[crosses(uv) & of_antenna(uv, 3)] = 1 + 2j


def far_too_strong(uv: UVData) -> None:
    uv.data_array[crosses(uv) & of_antenna(uv, 3)] *= 1e3


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (weak_autos, "its autocorrelations are 1e-09 of the others'"),
        (no_autos, "its autocorrelations are not positive"),
        (all_zero, "all its visibilities are zero"),
        (all_constant, "all its visibilities are constant"),
        (far_too_strong, "the power of its visibilities is"),
    ],
)
def test_dead_and_absurd_antennas(job: dict[str, Any], folder: Path, damage: Change, why: str) -> None:
    (one,) = found(job, folder, files=damaged(folder, damage))
    assert one.antennas == (3,)
    assert one.where == "antenna 3"
    assert one.why.startswith(why)
    assert found(job, folder, files=["damaged.uvh5"], exclude_antennas=[3]) == []


@pytest.mark.parametrize("how", ["noisy", "zero"])
def test_bad_integrations(job: dict[str, Any], folder: Path, how: str) -> None:
    """Two neighbours, one of which is held out, and a third that is.

    Differences of neighbours tell but one of those at a look; what all looks show at once is told as one.
    """

    def damage(uv: UVData) -> None:
        rows = crosses(uv) & at_times(uv, 4, 5, 14)
        if how == "noisy":
            noisy(uv, rows)
        else:
            uv.data_array[rows] = 0

    result = found(job, folder, files=damaged(folder, damage))
    with quiet():
        times = np.unique(UVData.from_file(folder / "data.uvh5", read_data=False).time_array)
    told = sorted(one.times[0] for one in result)
    expected = {"noisy": [[4], [5], [14]], "zero": [[4, 5], [14]]}
    assert [np.flatnonzero((times >= a) & (times <= b)).tolist() for a, b in told] == expected[how]
    roles = [one.where.partition(", ")[2] for one in result]
    alone = ["fitted", "held out"] if how == "noisy" else ["fitted and held out"]
    assert sorted(roles) == sorted([*alone, "held out"])
    spans = [list(one.times[0]) for one in result]
    assert found(job, folder, files=["damaged.uvh5"], exclude_times=spans) == []


def test_an_integration_that_was_counted_twice(tmp_path: Path) -> None:
    """Of times that lie far apart, so that no difference tells; redundant baselines are as much alike as before."""
    job = made(tmp_path, close=False)

    def twice(uv: UVData) -> None:
        uv.data_array[crosses(uv) & at_times(uv, 7)] *= 2

    (one,) = found(job, tmp_path, files=damaged(tmp_path, twice))
    assert one.what == "an integration on another scale"
    factor = re.search(r"when it is (\S+) times as large as at other times$", one.why)
    assert factor is not None
    assert float(factor[1]) == pytest.approx(2, rel=0.1)  # by as much the model beam is off
    with quiet():
        jd = np.unique(UVData.from_file(tmp_path / "data.uvh5", read_data=False).time_array)
    ((first, last),) = one.times
    assert [first <= time <= last for time in jd] == [k == 7 for k in range(N_TIMES)]


def test_a_flux_that_is_wrong_is_no_fault_of_the_times_at_which_it_is_seen(tmp_path: Path) -> None:
    assert found(made(tmp_path, {"kind": "catalogue_flux", "strength": 8.0}, close=False), tmp_path) == []


def test_bad_integrations_minutes_apart_are_off_among_redundant_baselines(tmp_path: Path) -> None:
    """The model lacks what is as strong as the sky, and tells nothing of them."""
    job = made(tmp_path, {"kind": "missing_sources", "strength": 200.0}, close=False)
    names = damaged(tmp_path, lambda uv: noisy(uv, crosses(uv) & at_times(uv, 4, 5, 14)))
    result = found(job, tmp_path, files=names)
    assert [one.what for one in result] == ["2 bad integrations", "a bad integration"]
    assert all(one.why.startswith("what redundant baselines in it differ by has") for one in result)
    assert re.search(r"has \d\S* to \d\S* times the power of others \(\d+ to \d+ sigma\)$", result[0].why)
    spans = [list(one.times[0]) for one in result]
    assert found(job, tmp_path, files=names, exclude_times=spans) == []


def test_without_redundancy_it_is_said_that_of_integrations_minutes_apart_only_gross_ones_are_found(
    tmp_path: Path,
) -> None:
    job = made(tmp_path, close=False)
    (one,) = found(job, tmp_path, exclude_antennas=[1, 4, 5, 6])
    assert one.line.startswith("Bad integrations show before a fit only where they are gross")
    assert not one.is_fault


@pytest.mark.mpi
def test_one_source_in_what_the_model_leaves_is_no_fault_of_an_integration(
    comm: MPI.Comm, common_tmp_path: Path
) -> None:
    """It is taken out of the residual, which noise of the same power stays in; whichever rank has which baselines."""
    if comm.rank == 0:
        made(common_tmp_path, close=False, hex=[3, 5])
    comm.Barrier()
    job = {**mock_job(), "data": {"files": ["data.uvh5"]}}
    write_job(job, common_tmp_path / f"rank{comm.rank}")
    problem = prepare(load_job(common_tmp_path / f"rank{comm.rank}" / "job.toml"), (common_tmp_path / "data.uvh5",))
    grid = ProcessGrid.split(comm, problem.observation.Nfreqs)
    sample = read_sample(grid, problem)
    ahead = problem.redundant.vectors[problem.redundant.group[sample.bls]] @ np.array([0.31, -0.52, 0.8])
    freqs = problem.observation.freqs[sample.channels, np.newaxis]
    residual = np.zeros_like(sample.data)
    residual[:, 3] = 5 * np.exp(2j * np.pi * freqs * ahead / 299792458.0)
    phases = generator(1, "phases", int(sample.channels[0]), *sample.bls.tolist()).uniform(0, 2 * np.pi, ahead.shape)
    residual[:, 7] = 5 * np.exp(1j * phases)
    rows = sample.channels, sample.bls
    left = np.abs(residual - brightest_source(grid, problem, rows, np.ones(residual.shape), residual)) ** 2
    power = comm.allreduce(left.sum(axis=(0, 2))) / comm.allreduce(np.prod(residual[:, 0].shape))
    assert power[3] < 0.1 * 25
    assert power[7] > 0.5 * 25
    assert not np.delete(power, [3, 7]).any()


def test_a_noisy_baseline(job: dict[str, Any], folder: Path) -> None:
    def damage(uv: UVData) -> None:
        noisy(uv, (uv.ant_1_array == 1) & (uv.ant_2_array == 4))

    (one,) = found(job, folder, files=damaged(folder, damage))
    assert one.baselines == ((1, 4),)
    assert found(job, folder, files=["damaged.uvh5"], exclude_baselines=[[4, 1]]) == []


def test_noise_beside_redundant_partners_needs_no_model(tmp_path: Path) -> None:
    """What the model lacks is as strong as the sky, and hides a noisy baseline from it."""
    job = made(tmp_path, {"kind": "missing_sources", "strength": 200.0})
    names = damaged(tmp_path, lambda uv: noisy(uv, (uv.ant_1_array == 1) & (uv.ant_2_array == 4), 0.2))
    (one,) = found(job, tmp_path, files=names)
    assert one.baselines == ((1, 4),)
    assert one.why.startswith("beside its redundant partners it has")
    assert found(job, tmp_path, files=names, exclude_baselines=[[1, 4]]) == []


def test_sky_that_the_model_lacks_is_no_noise(tmp_path: Path) -> None:
    assert found(made(tmp_path, {"kind": "missing_sources", "strength": 200.0}, hex=[3, 4]), tmp_path) == []


@pytest.mark.parametrize(
    ("kind", "settings", "strength"),
    [
        ("antenna_gains", {"law": "smooth", "orders": [1, 2]}, 0.5),
        ("antenna_pointing", {}, 3.0),
    ],
)
def test_baselines_that_effects_make_differ_from_their_partners(
    kind: str, settings: dict[str, Any], strength: float, tmp_path: Path
) -> None:
    """No fault: that is smooth in time, noise is not."""
    assert found(made(tmp_path, {"kind": kind, "settings": settings, "strength": strength}), tmp_path) == []


def exchanged(uv: UVData, times: Sequence[int] = range(N_TIMES)) -> None:
    """Exchange the labels of antennas 1 and 4, at some times."""
    label = {1: 4, 4: 1}
    then = at_times(uv, *times)
    uv.ant_1_array, uv.ant_2_array = (
        np.array([label.get(ant, ant) if now else ant for ant, now in zip(ants.tolist(), then, strict=True)])
        for ants in (uv.ant_1_array, uv.ant_2_array)
    )
    uv.baseline_array = uv.antnums_to_baseline(uv.ant_1_array, uv.ant_2_array)
    uv.conjugate_bls("ant1<ant2")  # as some times have a baseline one way round, and others the other


@pytest.mark.parametrize("phase", [0.0, 1.5])
def test_exchanged_antennas(phase: float, tmp_path: Path) -> None:
    """Also beside an antenna whose phase is far off, to which their baselines are bad wherever they are."""
    gain = {"kind": "antenna_gains", "parameters": {"antenna 2 phase": phase}}
    job = made(tmp_path, *([gain] if phase else []))
    (one,) = found(job, tmp_path, files=damaged(tmp_path, exchanged))
    assert (one.what, one.where, one.antennas) == ("two antennas exchanged", "antennas 1 and 4", (1, 4))
    assert "exclude_antennas = [1, 4]" in one.remedy


def test_exchanged_antennas_beside_what_one_baseline_sees(tmp_path: Path) -> None:
    """The shortest may have most of all power, from emission that the model lacks, and says nothing of their places."""

    def on_top(uv: UVData) -> None:
        exchanged(uv)
        rows = uv.antpair2ind(0, 1)
        uv.data_array[rows] += 5 * np.abs(uv.data_array[rows]).mean()

    (one,) = found(made(tmp_path), tmp_path, files=damaged(tmp_path, on_top))
    assert (one.what, one.where) == ("two antennas exchanged", "antennas 1 and 4")


@pytest.mark.parametrize("first", [0, 5, N_TIMES - 6])
def test_antennas_that_are_exchanged_for_a_while(first: int, tmp_path: Path) -> None:
    """As where cables were changed during the night."""
    during = range(first, first + 6)
    job = made(tmp_path)
    (one,) = found(job, tmp_path, files=damaged(tmp_path, lambda uv: exchanged(uv, during)))
    with quiet():
        jd = np.unique(UVData.from_file(tmp_path / "data.uvh5", read_data=False).time_array)
    where = f"antennas 1 and 4, JD {jd[during[0]]:.6f} to {jd[during[-1]]:.6f}"
    assert (one.what, one.where, one.antennas) == ("two antennas exchanged", where, (1, 4))
    assert "exchange their numbers in the files of these times" in one.remedy


def conjugated(uv: UVData, *pairs: tuple[int, int]) -> None:
    """Conjugate some baselines, all of them without any pairs."""
    for rows in [uv.antpair2ind(*pair) for pair in pairs] or [crosses(uv)]:
        uv.data_array[rows] = uv.data_array[rows].conj()


@pytest.mark.parametrize("phase", [0.0, 1.5])
def test_conjugated_baselines(phase: float, tmp_path: Path) -> None:
    """Also one of an antenna whose phase is far off."""
    gain = {"kind": "antenna_gains", "parameters": {"antenna 4 phase": phase}}
    job = made(tmp_path, *([gain] if phase else []), close=False)
    one, two = found(job, tmp_path, files=damaged(tmp_path, lambda uv: conjugated(uv, (0, 3), (2, 4))))
    assert {one.what, two.what} == {"a conjugated baseline"}
    assert (one.where, one.baselines, two.where, two.baselines) == (
        "baseline 0-3",
        ((0, 3),),
        "baseline 2-4",
        ((2, 4),),
    )
    assert "or exclude_baselines = [[0, 3]] in [data]" in one.remedy


def test_no_baseline_of_conjugated_data_is_wrong_by_itself(tmp_path: Path) -> None:
    assert found(made(tmp_path), tmp_path, files=damaged(tmp_path, conjugated)) == []


def test_an_antenna_is_named_instead_of_most_of_its_baselines(job: dict[str, Any], folder: Path) -> None:
    problem = prepare(load_job(write_job(job, folder)), (folder / "data.uvh5",))
    pairs = [(0, 1), (1, 2), (1, 3), (1, 4), (2, 4)]
    one, other = by_antenna(
        problem, [Finding("a bad baseline", str(pair), "", "", baselines=(pair,)) for pair in pairs]
    )
    assert one.baselines == ((2, 4),)
    assert (other.where, other.antennas, other.why) == ("antenna 1", (1,), "4 of its 6 baselines are bad")
    assert len(by_antenna(problem, [Finding("", "", "", "", baselines=(pair,)) for pair in pairs[:3]])) == 3


def test_a_channel_width_that_does_not_fit_its_autocorrelations(job: dict[str, Any], folder: Path) -> None:
    with quiet():
        width = float(UVData.from_file(folder / "data.uvh5", read_data=False).channel_width[0])
    (one,) = found(job, folder, channel_width=16 * width)
    assert one.what.startswith("noise unlike")
    suggested = float(one.remedy.split("'")[1].split()[0]) * 1e3
    assert suggested == pytest.approx(width, rel=0.25)  # three of its standard deviations
    assert mended_job(load_job(folder / "job.toml"), [one]).data.channel_width == 16 * width


def test_findings_do_not_depend_on_ranks(comm: MPI.Comm, common_tmp_path: Path) -> None:
    if comm.rank == 0:
        made(common_tmp_path)
        damaged(common_tmp_path, lambda uv: (noisy(uv, crosses(uv) & at_times(uv, 5)), all_zero(uv)))
    comm.Barrier()
    job = mock_job(n_times=N_TIMES)
    job["data"] = {"files": ["damaged.uvh5"]}
    shared = found(job, common_tmp_path, comm)
    assert [one.what for one in shared] == ["a dead or absurd antenna", "a bad integration"]
    alone = found(job, common_tmp_path)
    assert [(one.where, one.remedy) for one in shared] == [(one.where, one.remedy) for one in alone]


def test_the_loop_puts_aside_what_it_names(
    folder: Path, job: dict[str, Any], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Its result says so everywhere, and its amended job leaves out the same."""
    names = damaged(folder, lambda uv: (noisy(uv, crosses(uv) & at_times(uv, 5)), all_zero(uv)))
    path = write_job(
        {**job, "data": {"files": [str(folder / name) for name in names]}, "loop": {"effects": ["timestamp"]}}, tmp_path
    )
    out = tmp_path / "result"
    assert main(["loop", str(path), "-o", str(out)]) == 0
    err = capfd.readouterr().err
    loop, summary = (json.loads((out / f"{name}.json").read_text()) for name in ("loop", "summary"))
    assert [one["what"] for one in loop["health"]] == ["a dead or absurd antenna", "a bad integration"]
    assert set(loop["health"][0]) == {"what", "where", "why", "remedy"}
    data = tomllib.loads((out / "amended.toml").read_text())["data"]
    assert data["exclude_antennas"] == [3]
    assert len(data["exclude_times"]) == 1
    for words in (err, " ".join(summary["warnings"])):
        assert "A dead or absurd antenna (antenna 3)" in words
        assert "A bad integration (JD " in words
    assert loop["verdict"] != "convention"
