"""Effects in simulations: each changes the data, as named, as drawn, the same on any machine; or says why it cannot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVData

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS, SEPARATE, make_effect
from tests.cli.conftest import refusal
from tests.loop.mock import mock_job, write_job

FREQS = (127e6, 131e6, 135e6, 139e6)
PAIRS = np.array([(one, two) for one in range(7) for two in range(one + 1, 7)])


def job_with(*injected: dict[str, Any], noise: bool = False, freqs: tuple[float, ...] = FREQS) -> dict[str, Any]:
    job = mock_job(*injected, freqs=freqs, n_times=3)
    job["data"]["simulate"]["noise"] = noise
    return job


def simulated(job: dict[str, Any], folder: Path) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """Return cross-correlations, (Ntimes, Nbls, Nfreqs), and what was put in."""
    path = write_job(job, folder)
    assert main(["simulate", str(path), "-o", str(folder / "result"), "--overwrite"]) == 0
    uv = UVData.from_file(folder / "result" / "data.uvh5")
    uv.select(ant_str="cross")
    with h5py.File(folder / "result" / "truth.h5") as file:
        truth = json.loads(file.attrs["effects"])
    data = np.array([uv.get_data(*pair) for pair in uv.get_antpairs()])
    return np.moveaxis(data, 0, 1), truth


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    data, truth = simulated(job_with(), tmp_path_factory.mktemp("clean"))
    assert truth == []
    assert data.shape == (3, 21, 4)
    return data


@pytest.mark.parametrize("kind", EFFECTS)
def test_every_effect_changes_the_data_as_it_says(kind: str, clean: np.ndarray, tmp_path: Path) -> None:
    """Drawn at random, written down, and the same again from what is written down."""
    drawn, (truth,) = simulated(job_with({"kind": kind, "strength": 0.3}), tmp_path)
    size = np.abs(clean).max()
    assert np.abs(drawn - clean).max() > 1e-6 * size
    assert truth["kind"] == kind
    values = np.array(truth["values"])
    assert values.shape == (4, len(truth["names"]))
    effect = make_effect(kind, truth["settings"])
    assert np.all(values == values[0]) == effect.shared
    if effect.shared:
        named = dict(zip(truth["names"], truth["values"][0], strict=True))
        injected = {"kind": kind, "settings": truth["settings"], "parameters": named}
        given, (again,) = simulated(job_with(injected), tmp_path)
        np.testing.assert_allclose(again["values"], values, rtol=1e-14)
        np.testing.assert_allclose(given, drawn, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("kind", REWEIGHTINGS)
def test_every_change_of_weights_changes_the_data_but_not_the_weights(kind: str, tmp_path: Path) -> None:
    plain, _ = simulated(job_with(noise=True), tmp_path / "plain")
    noisy, truths = simulated(job_with({"kind": kind, "strength": 0.5}, noise=True), tmp_path / "noisy")
    changed = np.any(noisy != plain, axis=(0, 1))
    assert changed.all()
    assert [(truth["kind"], truth["channel"]) for truth in truths] == [(kind, f) for f in range(4)]
    one, two = (UVData.from_file(tmp_path / name / "result" / "data.uvh5") for name in ("plain", "noisy"))
    np.testing.assert_array_equal(one.nsample_array, two.nsample_array)
    assert not np.any(two.flag_array)


def test_noise_is_scaled_as_named(tmp_path: Path, clean: np.ndarray) -> None:
    plain, _ = simulated(job_with(noise=True), tmp_path)
    named = {"noise scale": 2.0, "antenna 3 noise scale": 3.0}
    noisy, truths = simulated(job_with({"kind": "noise_level", "parameters": named}, noise=True), tmp_path)
    assert [truth["values"][:5] for truth in truths] == [[2.0, 1.0, 1.0, 1.0, 3.0]] * 4
    with_3 = (PAIRS == 3).any(axis=1)
    for rows, power in ((~with_3, 4.0), (with_3, 12.0)):
        expected = power * np.mean(np.abs(plain - clean)[:, rows] ** 2)
        found = np.mean(np.abs(noisy - clean)[:, rows] ** 2)
        assert found == pytest.approx(expected, rel=0.5)


def polarised(*injected: dict[str, Any], folder: Path, noise: bool = False) -> dict[str, np.ndarray]:
    """Return cross-correlations by polarisation, (Nfreqs, Ntimes, Nbls), and their autocorrelations."""
    simulated(job_with(*injected, noise=noise), folder)
    uv = UVData.from_file(folder / "result" / "data.uvh5")
    assert uv.get_pols() == ["ee", "nn", "en", "ne"]
    pairs = [pair for pair in uv.get_antpairs() if pair[0] != pair[1]]
    crosses = {pol: np.array([uv.get_data(*pair, pol).T for pair in pairs]) for pol in uv.get_pols()}
    autos = {f"{pol} auto": uv.get_data(0, 0, pol).T for pol in ("ee", "nn")}
    return {pol: np.moveaxis(vis, 0, 2) for pol, vis in crosses.items()} | autos


def test_leakage_mixes_the_feeds(clean: np.ndarray, tmp_path: Path) -> None:
    """V' = J V J^H with J = [[1, d_e], [d_n, 1]], the job's feed as it is without leakage, the other one turned."""
    named = {f"antenna 3 feed {feed} leakage, {part} part": value for feed, part, value in TERMS}
    before = polarised({"kind": "leakage", "parameters": {"antenna 3 feed e leakage, real part": 0}}, folder=tmp_path)
    after = polarised({"kind": "leakage", "parameters": named}, folder=tmp_path)
    np.testing.assert_allclose(np.moveaxis(before["ee"], 0, 2), clean, rtol=0, atol=1e-12 * np.abs(clean).max())
    # Turned by 90 degrees an Airy beam stretched alike along both axes is the same, ...
    np.testing.assert_allclose(before["nn"], before["ee"], rtol=0, atol=1e-9 * np.abs(clean).max())
    assert not np.any(before["en"])
    assert not np.any(before["ne"])
    d = np.zeros((7, 2), dtype=complex)
    d[3] = 0.1 - 0.2j, 0.05j
    jones = np.array([[[1, into_e], [into_n, 1]] for into_e, into_n in d])
    coherency = np.array([[before["ee"], before["en"]], [before["ne"], before["nn"]]])
    one, two = jones[PAIRS].transpose(1, 0, 2, 3)
    expected = np.einsum("bij,jkftb,blk->ilftb", one, coherency, two.conj())
    for pol in ("ee", "nn", "en", "ne"):
        found = after[pol]
        np.testing.assert_allclose(found, expected["en".index(pol[0]), "en".index(pol[1])], rtol=0, atol=1e-12)


TERMS = [("e", "real", 0.1), ("e", "imaginary", -0.2), ("n", "imaginary", 0.05)]


def test_both_feeds_have_the_same_effects_and_noise_of_their_own(tmp_path: Path) -> None:
    gain = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.5}}
    leak = {"kind": "leakage", "strength": 0.1}
    plain, louder = (polarised(*effects, folder=tmp_path) for effects in ([leak], [leak, gain]))
    factor = np.where((PAIRS == 2).any(axis=1), np.exp(0.5), 1.0)
    for pol in ("ee", "nn", "en", "ne"):
        assert np.abs(plain[pol]).max() > 0
        np.testing.assert_allclose(louder[pol], factor * plain[pol], rtol=0, atol=1e-12)
    noisy = polarised(leak, folder=tmp_path, noise=True)
    noise = {pol: noisy[pol] - plain[pol] for pol in ("ee", "nn", "en", "ne")}
    samples = 100e3 * 10.0
    for pol, values in noise.items():
        variance = noisy[f"{2 * pol[0]} auto"].real * noisy[f"{2 * pol[1]} auto"].real / samples
        values /= np.sqrt(variance[..., np.newaxis])
        assert np.mean(np.abs(values) ** 2) == pytest.approx(1, abs=5 / np.sqrt(values.size))
    alike = np.corrcoef([values.ravel() for values in noise.values()]) - np.eye(4)
    assert np.abs(alike).max() < 5 / np.sqrt(values.size)


def test_parameters_by_name(clean: np.ndarray, tmp_path: Path) -> None:
    """A gain multiplies the baselines of its antenna, and a coupling adds to its baseline."""
    injected = [
        {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.1, "antenna 2 phase": 0.3}},
        {
            "kind": "cross_coupling",
            "settings": {"baselines": [[1, 4]]},
            "parameters": {"baseline 1-4 real": 0.25},
        },
    ]
    data, truth = simulated(job_with(*injected), tmp_path)
    assert [one["kind"] for one in truth] == ["antenna_gains", "cross_coupling"]
    assert np.count_nonzero(truth[0]["values"]) == 2 * 4
    gain = np.exp(0.1 + 0.3j)
    for row, (one, two) in enumerate(PAIRS.tolist()):
        expected = clean[:, row] * (gain if one == 2 else 1) * (np.conj(gain) if two == 2 else 1)
        if (one, two) == (1, 4):
            expected = expected + 0.25
        np.testing.assert_allclose(data[:, row], expected, rtol=1e-12)


def test_strength_is_in_natural_sizes(tmp_path: Path) -> None:
    _, (one,) = simulated(job_with({"kind": "antenna_gains", "strength": 0.01}), tmp_path)
    _, (two,) = simulated(job_with({"kind": "antenna_gains", "strength": 0.5}), tmp_path)
    np.testing.assert_allclose(50 * np.array(one["values"]), two["values"], rtol=1e-12)
    assert np.std(two["values"]) == pytest.approx(0.5, rel=0.3)


def test_the_second_of_a_kind_is_another_one(tmp_path: Path) -> None:
    twice = [{"kind": "cross_coupling"}, {"kind": "cross_coupling"}]
    _, (one, two) = simulated(job_with(*twice), tmp_path)
    assert one["values"] != two["values"]


@pytest.mark.mpi
def test_any_number_of_ranks_injects_the_same(comm: MPI.Comm, common_tmp_path: Path) -> None:
    injected = [{"kind": "antenna_gains"}, {"kind": "missing_sources"}, {"kind": "outliers", "strength": 0.5}]
    folder = common_tmp_path / "all"
    path = write_job(job_with(*injected, noise=True), folder) if comm.rank == 0 else folder / "job.toml"
    comm.Barrier()
    assert main(["simulate", str(path), "-o", str(folder / "result")]) == 0
    with h5py.File(folder / "result" / "truth.h5") as file:
        truth = json.loads(file.attrs["effects"])
    assert [one["kind"] for one in truth] == ["antenna_gains", "missing_sources"] + ["outliers"] * 4
    # From what was drawn on one rank, before there were others.
    assert truth[1]["settings"]["sources"] == [pytest.approx(DRAWN, rel=1e-12)]


DRAWN = [150.37974683544303, -21.97674418604651]  # degrees


@pytest.mark.parametrize(
    ("injected", "freqs", "expected"),
    [
        (
            {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitud": 1.0}},
            FREQS,
            "(antenna_gains) parameters: no 'antenna 2 ln amplitud'; there are 'antenna 2 ln amplitude', ",
        ),
        (
            {"kind": "antenna_gains", "parameters": {"qwertz": 1.0}},
            FREQS,
            "(antenna_gains) parameters: no 'qwertz'; there are 'antenna 0 ln amplitude', 'antenna 0 phase', ",
        ),
        (
            {"kind": "closure_errors", "parameters": {"baseline 3-4 phase": 1.0}},
            FREQS,
            "(closure_errors) parameters: no 'baseline 3-4 phase'; there are 'baseline 2-5 phase', "
            "'baseline 2-5 ln amplitude' ... by settings = { baselines = [[2, 5]] }; name others there",
        ),
        (
            {"kind": "noise_level", "parameters": {"noise": 1.0}},
            FREQS,
            "(noise_level) parameters: no 'noise'; there are 'noise scale'",
        ),
        (
            {"kind": "noise_level", "parameters": {"noise scale": 0.5}},
            FREQS,
            "(noise_level) noise_level: noise cannot be taken away; give scales of 1 or more",
        ),
        (
            {"kind": "antenna_gains", "settings": {"antennas": [1]}},
            FREQS,
            "(antenna_gains) settings: are not understood; there are channels, as 'hydrabeam loop' writes them",
        ),
        (
            {"kind": "antenna_gains", "settings": {"channels": "some"}},
            FREQS,
            "(antenna_gains) settings: are not understood; there are channels, as 'hydrabeam loop' writes them",
        ),
        (
            {"kind": "outliers", "settings": {"of": 1}},
            FREQS,
            "(outliers) settings: are not understood; there are levels, as 'hydrabeam loop' writes them",
        ),
        (
            {"kind": "cross_coupling", "settings": {"baselines": [[0, 77]]}, "parameters": {"x": 1.0}},
            FREQS,
            "(cross_coupling) baselines: no baseline 0-77 in the data; name pairs of antennas that are",
        ),
        (
            {"kind": "cross_coupling", "settings": {"baselines": 3}},
            FREQS,
            "(cross_coupling) settings: are not understood; there are baselines, as 'hydrabeam loop' writes them",
        ),
        (
            {"kind": "antenna_delays"},
            FREQS[:1],
            "(antenna_delays): a delay needs several channels; with one it is a gain phase; remove it",
        ),
        ({"kind": "cable_reflections"}, FREQS[:2], "(cable_reflections): a reflection is a ripple of the gain"),
        (
            {"kind": "leakage", "settings": {"feeds": "en"}},
            FREQS,
            "(leakage) settings: are not understood; leave them out",
        ),
    ],
)
def test_what_cannot_be_simulated(
    injected: dict[str, Any],
    freqs: tuple[float, ...],
    expected: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = write_job(job_with({"kind": "timestamp"}, injected, freqs=freqs), tmp_path)
    for more in ([], ["--dry-run"]):
        assert main(["simulate", str(path), "-o", str(tmp_path / "result"), *more]) == 2
        said = refusal(capfd, MPI.COMM_SELF)
        assert said.startswith(f"hydrabeam: error: {path}: [[data.simulate.effects]] number 2 {expected}")
    assert not (tmp_path / "result").exists()


def test_every_kind_is_either_simulated_or_refused() -> None:
    """So that the tests above leave none out."""
    assert {*SEPARATE} == {"leakage"}
    assert not set(EFFECTS) & set(REWEIGHTINGS)
    assert all(EFFECTS[cls.kind] is cls for cls in (AntennaGains, AntennaDelays, CrossCoupling))
