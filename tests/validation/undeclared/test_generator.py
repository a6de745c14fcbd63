"""The generator by itself: that it shares nothing with the package, and is right where nothing is wrong."""

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.constants import c as speed_of_light
from mpi4py import MPI
from pyuvdata import UVData

from hydrabeam_mpi.commands.infer import infer
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.effects.registry import EFFECTS as KNOWN
from hydrabeam_mpi.effects.registry import KINDS, REWEIGHTINGS
from tests.validation.undeclared import skies, strange
from tests.validation.undeclared.answer import Kind, Where
from tests.validation.undeclared.beams import drawn_shape
from tests.validation.undeclared.cases import ALL, CONVENTIONS, EFFECTS, FAULTS
from tests.validation.undeclared.detect import chi2_beyond_beam, numbers_of_unknown, shows
from tests.validation.undeclared.gains import antenna_gains
from tests.validation.undeclared.generate import MOST_BEYOND_BASIS, generate, make, stream
from tests.validation.undeclared.setting import Plan, altaz, draw_setting, icrs
from tests.validation.undeclared.simulator import correlations, corrupted, on_baselines
from tests.validation.undeclared.truth import Truth

SOURCES = sorted(path for path in Path(__file__).parent.glob("*.py") if not path.stem.startswith("test_"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_shares_nothing_with_the_package(path):
    imported = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            imported |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module)
    assert not {name for name in imported if name.startswith("hydrabeam_mpi")}
    assert {name for name in imported if name.startswith("tests.")} <= {
        f"tests.validation.undeclared{name}" for name in ["", *(f".{other.stem}" for other in SOURCES)]
    }


@pytest.fixture(scope="module")
def nothing_wrong():
    setting = draw_setting(np.random.default_rng(5), Plan(n_times=4, n_freqs=2))
    truth = Truth.of(setting, drawn_shape(np.random.default_rng(6), setting.model_shape))
    return truth, correlations(truth)


def test_the_visibilities_are_the_sum_over_sources(nothing_wrong):
    """Signs and the factor 1/2 once more, as a plain sum."""
    truth, found = nothing_wrong
    setting = truth.setting
    for f, freq in enumerate(setting.freqs):
        for t, time in enumerate(setting.times):
            za, az = altaz(setting.catalogue.ra, setting.catalogue.dec, time)
            directions = np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])
            seen = 0.5 * setting.catalogue.at(freq) * truth.shapes[0].power(za, az, freq) * (za <= np.pi / 2)
            expected = np.exp(2j * np.pi * freq / speed_of_light.value * (setting.bl_vectors @ directions)) @ seen
            np.testing.assert_allclose(on_baselines(truth, found)[f, t], expected, rtol=0, atol=1e-9)


def test_antennas_with_beams_of_their_own_see_products_of_fields(nothing_wrong):
    truth, _ = nothing_wrong
    shape = truth.shapes[0]
    half = replace(shape, extra=lambda l, m: np.full_like(l, -0.5))
    other = Truth.of(truth.setting, shape)
    other.shapes = [half, *other.shapes[1:]]
    before, after = nothing_wrong[1], correlations(other)
    np.testing.assert_allclose(after[:, :, 0, 1:], 0.5 * before[:, :, 0, 1:], atol=1e-9)
    np.testing.assert_allclose(after[:, :, 1:, 0], 0.5 * before[:, :, 1:, 0], atol=1e-9)
    np.testing.assert_allclose(after[:, :, 1:, 1:], before[:, :, 1:, 1:], atol=1e-9)
    np.testing.assert_allclose(after[:, :, 0, 0], 0.25 * before[:, :, 0, 0], atol=1e-9)


def test_a_tilted_beam_points_where_it_is_tilted_to():
    setting = draw_setting(np.random.default_rng(5), Plan())
    tilt = np.deg2rad(20)
    shape = replace(setting.model_shape, pointing=(np.sin(tilt), 0.0))
    values = shape.power(np.array([tilt, tilt, 0.0]), np.array([0.0, np.pi, 0.0]), 150e6)
    assert values[0] == pytest.approx(1.0)
    assert values[1] < 0.2 * values[2] < 0.2


def test_the_sky_is_turned_towards_where_it_should(nothing_wrong):
    catalogue, time = nothing_wrong[0].setting.catalogue, nothing_wrong[0].setting.times[0]
    ra, dec = icrs(np.array([1e-9]), np.array([0.0]), time)
    zenith = replace(catalogue, ra=ra, dec=dec, flux=np.ones(1), index=np.zeros(1))
    moved = skies.turned(zenith, time, 0.01, 0.02)
    za, az = altaz(moved.ra, moved.dec, time)
    np.testing.assert_allclose([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az)], [[0.01], [0.02]], rtol=1e-4)


def test_the_beam_absorbs_a_common_gain_and_not_that_of_one_antenna(nothing_wrong):
    truth, _ = nothing_wrong
    setting, shape = truth.setting, truth.setting.model_shape
    clean = on_baselines(truth, correlations(Truth.of(setting, shape)))
    total, left = chi2_beyond_beam(setting, 0.1 * clean, 0.1)
    assert left < 1e-6 * total
    one = Truth.of(setting, shape)
    antenna_gains(one, np.random.default_rng(3), 0.1)
    total, left = chi2_beyond_beam(setting, on_baselines(one, corrupted(one)) - clean, 0.1)
    assert left > 0.3 * total


def test_an_antenna_that_turns_turns_alone(nothing_wrong):
    truth, before = nothing_wrong
    loose = Truth.of(truth.setting, truth.shapes[0])
    where = strange.turning_antenna(loose, np.random.default_rng(3), 0.1).where.antennas
    index = truth.setting.numbers.tolist().index(where[0])
    change = np.abs(correlations(loose) - before).max(axis=(0, 1))
    others = np.delete(np.arange(truth.setting.n_ants), index)
    np.testing.assert_allclose(change[np.ix_(others, others)], 0, atol=1e-9)
    assert change[index, others].min() > 1e-3


def test_visibilities_stay_hermitian_whatever_a_board_or_a_tone_does(nothing_wrong):
    truth, before = nothing_wrong
    for apply in (strange.board_stops_wrong_fringes, strange.wandering_oscillator, strange.cables_swapped):
        wrong = Truth.of(truth.setting, truth.shapes[0])
        drawn = apply(wrong, np.random.default_rng(3), 0.3)
        after = corrupted(wrong, before)
        np.testing.assert_allclose(after, after.conj().swapaxes(-1, -2), atol=1e-9)
        if drawn.where.antpairs is not None:
            hit = {tuple(sorted(pair)) for pair in drawn.where.antpairs}
            changed = np.abs(after - before).max(axis=(0, 1)) > 1e-9
            numbers = truth.setting.numbers
            assert {tuple(sorted((numbers[i], numbers[j]))) for i, j in np.argwhere(changed)} == hit


def test_noise_from_autocorrelations_is_that_of_the_data(tmp_path):
    generate(3, tmp_path, "dead_antennas")
    told = json.loads((tmp_path / "sealed" / "answer.json").read_text())
    uv = UVData.from_file(tmp_path / "given" / "data.uvh5")
    autos = {number: np.abs(uv.get_data(number, number)).max() for number in uv.telescope.antenna_numbers}
    alive = max(autos.values())
    assert alive / np.sqrt(uv.channel_width[0] * uv.integration_time[0]) == pytest.approx(told["sigma"])
    assert [number for number, auto in autos.items() if auto < 1e-5 * alive] == told["effects"][0]["where"]["antennas"]
    assert 'kind = "autocorrelations"' in (tmp_path / "given" / "job.toml").read_text()


@pytest.mark.study
@pytest.mark.parametrize("name", ALL)
def test_every_effect_is_one(name):
    """It changes the data or their noise; drawn twice with one seed it is the same."""
    kind: Kind = ALL[name]
    made, again = (make(7, [kind], [kind]) for _ in range(2))
    assert made.effects[0][1:] == again.effects[0][1:]
    assert kind.weakest <= made.effects[0][1] <= kind.strongest
    truth = made.truth
    ones = np.ones(truth.setting.shape, dtype=complex)
    if truth.noise:
        assert not np.allclose(truth.noise[0](ones, stream(1, "noise")), ones)
        return
    if truth.leakage is not None:
        assert np.abs(truth.leakage).max() > 0
        return
    if truth.filed:
        data = stream(1, "data").standard_normal(ones.shape) + 1j
        assert not np.allclose(truth.filed[0](data), data)
        return
    few = make(7, [kind], []).truth
    assert np.abs(corrupted(truth) - correlations(few)).max() > 1e-6


def infer_summary(folder):
    job = folder / "given" / "job.toml"
    infer(MPI.COMM_SELF, load_job(job), job, folder / "out", overwrite=False, threads=1)
    return json.loads((folder / "out" / "summary.json").read_text())


@pytest.mark.parametrize(("seed", "basis"), [(1, "study"), (2, "study"), (1, "default")])
def test_where_nothing_is_wrong_the_beam_explains_the_data(tmp_path, seed, basis):
    """The basis follows the true beam to below the noise: what the loop finds is not the basis's fault."""
    generate(seed, tmp_path, "null", basis)
    summary = infer_summary(tmp_path)
    assert summary["ppd_z_std"] == pytest.approx(1.0, abs=4 / np.sqrt(2 * 2 * summary["heldout_n"]))
    assert summary["heldout_chi2_unperturbed"] > 3


@pytest.mark.parametrize("basis", ["study", "paper"])
def test_what_the_basis_lacks_of_the_beam_is_below_the_noise(tmp_path, basis):
    """Of this seed the beam was too fine for the basis at the noise drawn first: that would be an effect."""
    generate(9008, tmp_path, "null", basis)
    clean = make(9008, [], [], basis).truth
    told = json.loads((tmp_path / "sealed" / "answer.json").read_text())
    beyond = chi2_beyond_beam(clean.setting, on_baselines(clean, correlations(clean)), told["sigma"])[1]
    assert beyond == pytest.approx(MOST_BEYOND_BASIS)
    assert f'sigma = "{told["sigma"]:.17g} Jy"' in (tmp_path / "given" / "job.toml").read_text()


def test_a_gross_error_is_one_to_the_inference(tmp_path):
    generate(3, tmp_path, "convention: conjugated")
    assert infer_summary(tmp_path)["heldout_chi2_noise_only"] > 100


def test_the_answer_is_sealed_apart(tmp_path):
    generate(4, tmp_path, "antenna_gains+outliers")
    assert {path.name for path in (tmp_path / "given").iterdir()} == {
        "data.uvh5",
        "catalogue.skyh5",
        "beam.beamfits",
        "job.toml",
    }
    answer = json.loads((tmp_path / "sealed" / "answer.json").read_text())
    assert [effect["kind"] for effect in answer["effects"]] == ["antenna_gains", "outliers"]
    assert "antenna_gains" not in (tmp_path / "given" / "job.toml").read_text()


def test_names_are_of_known_effects_and_of_mistakes():
    # Bad integrations are an effect that the loop knows, and data that are not to be fitted as they are. What is in bad
    # baselines has no name, nor has what is in integrations that carry something unknown.
    nameless = {kind for kind, change in REWEIGHTINGS.items() if change.is_of_unknown}
    assert nameless == {"bad_baselines", "unknown_integrations"}
    sought = {kind for kind in KINDS if kind not in KNOWN or KNOWN[kind].is_sought} - nameless
    assert set(EFFECTS) <= sought <= set(EFFECTS) | set(FAULTS)
    assert all(name.startswith("convention: ") for name in CONVENTIONS)


def test_what_no_list_has_shows_where_a_larger_variance_does(nothing_wrong):
    setting = nothing_wrong[0].setting
    n_freqs, n_times, n_bls = setting.shape
    assert numbers_of_unknown(setting, Where()) == n_freqs * n_times * n_bls
    antenna, pair = int(setting.numbers[3]), setting.numbers[setting.antpairs[5]].tolist()
    assert numbers_of_unknown(setting, Where(antennas=[antenna])) == n_freqs * n_times * (setting.n_ants - 1)
    assert numbers_of_unknown(setting, Where(antpairs=[pair], times=[0, 2])) == n_freqs * 2
    assert numbers_of_unknown(setting, Where(freqs=[float(setting.freqs[0])])) == n_times * n_bls
    # Of a thousand data with a chi^2 that is larger by 10% of two each, twice the ln likelihood ratio is about 9.
    assert not shows(200.0, 1000)
    assert shows(200.0, 10)
    assert shows(600.0, 1000)
