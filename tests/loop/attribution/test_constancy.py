"""Random effects between parts against densities of the data themselves, by brute force, and what a loop's rows say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_pointing import AntennaPointing
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.diffuse import Diffuse
from hydrabeam_mpi.effects.sky.ionosphere import Ionosphere
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution import parts
from hydrabeam_mpi.loop.attribution.constancy import Constancy, Spectrum, compare
from hydrabeam_mpi.loop.attribution.parts import Affected, ask_constancy, likelihoods_of, parted_block
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.candidate_fits import fit_candidate
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refusal import margin_of_parts, refusal_by_parts
from hydrabeam_mpi.loop.selection.taken_back import as_one_of_parts, take_back
from hydrabeam_mpi.random import generator
from tests.effects.small import small_setup
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

N_DATA, N_PARTS = 48, 4
STD = np.array([2.0, 0.5])
SPREADS = np.exp(np.linspace(np.log(1e-4), np.log(30), 150))


@dataclass(frozen=True)
class Model:
    """Real data y = A b + sum_k S_k x_k + n with b ~ N(0, 1) and white noise of variance one, S_k those of part k."""

    design: FloatArray
    columns: FloatArray
    data: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Of the data without the effect."""
        return np.eye(len(self.data)) + self.design @ self.design.T

    @property
    def likelihood(self) -> Likelihood:
        inverse = np.linalg.inv(self.covariance)
        signal = self.columns.T @ self.columns
        return Likelihood(self.columns.T @ inverse @ self.columns, self.columns.T @ inverse @ self.data, signal)

    def log_evidence(self, spread: float, has_common: bool) -> float:
        """Compare the density of the data with and without the effect."""
        common = np.tile(np.diag(STD), N_PARTS).T
        prior = np.kron(np.eye(N_PARTS), np.diag((spread * STD) ** 2)) + has_common * common @ common.T
        with_effect = self.covariance + self.columns @ prior @ self.columns.T
        one, two = (self.data @ np.linalg.solve(c, self.data) for c in (with_effect, self.covariance))
        log_dets = [np.linalg.slogdet(c)[1] for c in (with_effect, self.covariance)]
        return 0.5 * float(two - one + log_dets[1] - log_dets[0])


def make_model(
    seed: int, common: FloatArray, spread: float, informed: FloatArray | None = None, size: float = 1.0
) -> Model:
    """Draw a model whose parts differ by ``spread``; ``informed`` tells which parameters each part tells of, (K, q).

    ``size`` is that of the columns.
    """
    rng = generator(seed, "parts")
    part, q = np.arange(N_DATA) % N_PARTS, len(STD)
    columns = np.zeros((N_DATA, N_PARTS, q))
    columns[np.arange(N_DATA), part] = size * rng.standard_normal((N_DATA, q))
    if informed is not None:
        columns *= informed
    flat = columns.reshape(N_DATA, -1)
    design = rng.standard_normal((N_DATA, 5))
    x = common + spread * STD * rng.standard_normal((N_PARTS, q))
    data = design @ rng.standard_normal(5) + flat @ x.ravel() + rng.standard_normal(N_DATA)
    return Model(design, flat, data)


def spectrum_of(model: Model) -> Spectrum:
    scale, block = np.tile(STD, N_PARTS), model.likelihood
    return Spectrum.of(np.outer(scale, scale) * block.information, scale * block.score, len(STD))


@pytest.mark.parametrize("spread", [0.0, 1e-3, 0.7, 40.0])
def test_evidence_with_and_without_a_common_part(spread: float) -> None:
    model = make_model(1, np.array([3.0, -1.0]), 0.5)
    spectrum = spectrum_of(model)
    assert spectrum.with_common(spread) == pytest.approx(model.log_evidence(spread, True), rel=1e-9)
    assert spectrum.without_common(spread) == pytest.approx(model.log_evidence(spread, False), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("price", [0.0, 4.0])
@pytest.mark.parametrize(("common", "spread"), [((9.0, -2.0), 0.0), ((9.0, -2.0), 0.4), ((0.0, 0.0), 3.0)])
def test_the_bayes_factor_is_of_the_best_spreads(common: tuple[float, float], spread: float, price: float) -> None:
    """Over independent channels that have one spread."""
    models = [make_model(seed, np.array(common), spread) for seed in (2, 3)]
    found = compare([model.likelihood for model in models], STD, "times", price, [1.0, 1.0])
    with_common, without = (
        max(sum(model.log_evidence(one, has) for model in models) for one in (0.0, *SPREADS)) for has in (True, False)
    )
    expected = with_common - price - max(without - price, 0.0)
    assert found.log_bayes_factor == pytest.approx(expected, abs=0.05)
    assert found.between == "times"


def test_what_is_expected_is_the_mean_over_noise() -> None:
    """At any one spread, of data with the common part that was found."""
    model = make_model(4, np.array([2.0, -0.5]), 0.0)
    same = spectrum_of(model).of_the_same()
    x = np.tile(STD * spectrum_of(model).common_part(0.0), N_PARTS)
    rng = generator(4, "noise")
    root = np.linalg.cholesky(model.covariance)
    draws = [
        spectrum_of(replace(model, data=model.columns @ x + root @ rng.standard_normal(N_DATA))) for _ in range(2000)
    ]
    for spread in (0.0, 0.8):
        for of in (Spectrum.with_common, Spectrum.without_common):
            found = np.array([of(one, spread) for one in draws])
            assert abs(of(same, spread) - found.mean()) < 4 * found.std() / np.sqrt(len(found)) + 1e-9


def test_what_is_the_same_has_a_common_part() -> None:
    found = compare([make_model(5, np.array([2.0, -0.5]), 0.0, size=10.0).likelihood], STD, "times", 2.0, [1.0])
    assert found.log_bayes_factor > 5
    assert found.log_bayes_factor == pytest.approx(found.expected, abs=5)
    assert found.spread < 0.05


def test_what_differs_has_none() -> None:
    models = [make_model(seed, np.zeros(2), 1.0, size=10.0) for seed in range(10, 40)]
    found = [compare([model.likelihood], STD, "times", 2.0, [1.0]) for model in models]
    assert max(one.log_bayes_factor for one in found) < 5
    assert np.mean([one.log_bayes_factor for one in found]) < 0
    assert min(one.spread for one in found) > 0.5
    # The mean of few parts is not zero, and one of so much would be seen where it is the same in all.
    assert np.median([one.expected - one.log_bayes_factor for one in found]) > 5


def test_data_of_another_variance_are_the_same_data_with_other_errors() -> None:
    """What compares three times as wide errors is what compares data, columns and noise a third as large."""
    model = make_model(6, np.array([2.0, -0.5]), 0.3, size=10.0)
    whole = model.likelihood
    third = Likelihood(whole.information / 9, whole.score / 9, whole.signal / 9)
    found = compare([whole], STD, "times", 2.0, [9.0])
    expected, by_noise = (compare([one], STD, "times", 2.0, [1.0]) for one in (third, whole))
    for name in ("log_bayes_factor", "expected", "spread"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-6)
    assert found.expected_by_noise == pytest.approx(by_noise.expected)
    assert found.expected < found.expected_by_noise


def test_a_spread_is_measured() -> None:
    many = [make_model(seed, np.array([2.0, -0.5]), 0.25, size=10.0).likelihood for seed in range(50, 80)]
    found = compare(many, STD, "baselines", 1.0, np.ones(len(many)))
    assert found.spread == pytest.approx(0.25, rel=0.15)


def test_nothing_can_be_said_of_what_one_part_tells() -> None:
    """Each parameter is told by one part, another one each: both hypotheses are the same."""
    informed = np.zeros((N_PARTS, 2))
    informed[1, 0] = informed[2, 1] = 1.0
    for seed in range(5):
        model = make_model(seed, np.array([9.0, -2.0]), 3.0, informed)
        assert np.linalg.matrix_rank(model.likelihood.information) == 2
        found = compare([model.likelihood], STD, "times", 1.0, [1.0])
        # A prior twice as wide can be no common part.
        assert -1.5 < found.log_bayes_factor <= 0.01
        assert -1.5 < found.expected <= 0.01


GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}


@pytest.fixture(scope="module")
def with_gain(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitContext, Fitted]:
    """Data with one antenna's gain off, fitted with gains of three antennas and a coupling."""
    context = context_of(mock_job(GAIN), tmp_path_factory.mktemp("constancy"))
    gains, coupling = AntennaGains(), CrossCoupling([[1, 4]])
    var = np.zeros(14)
    var[[4, 5, 6, 7, 10, 11]] = 0.05**2
    active = (
        Active.start(gains, context.setup, var, np.zeros((1, 14))),
        Active.start(coupling, context.setup, np.full(2, 0.1), np.zeros((1, 2))),
    )
    return context, refit(context, Values(active))


def test_all_parts_together_say_what_the_whole_says(with_gain: tuple[FitContext, Fitted]) -> None:
    context, fitted = with_gain
    one, rest = fitted.values.active[0], replace(fitted.values, active=fitted.values.active[1:])
    parted = parted_block(context, one, one.used)
    assert parted.n_parts == {"times": 4, "baselines": 4}
    everything = {kind: np.zeros_like(part) for kind, part in parted.parts.items()}
    one_part = replace(parted, parts=everything, n_parts=dict.fromkeys(parted.n_parts, 1))
    in_parts, as_one = (likelihoods_of(context, fitted, {0: block}) for block in (parted, one_part))
    assert in_parts is not None
    assert as_one is not None
    found, whole = in_parts[0], as_one[0]
    other = len(rest.shared)
    own = other + np.arange(len(one.used))
    for span in parted.spans.values():
        place = slice(other + span.start, other + span.stop)
        n = parted.n_parts["times"]
        summed = found[0].information[place, place].reshape(n, len(one.used), n, len(one.used)).sum(axis=(0, 2))
        np.testing.assert_allclose(summed, whole[0].information[np.ix_(own, own)], rtol=1e-9, atol=1e-9 * summed.max())
        score = found[0].score[place].reshape(n, -1).sum(axis=0)
        np.testing.assert_allclose(score, whole[0].score[own], rtol=1e-9, atol=1e-9 * np.abs(score).max())
        across = found[0].information[:other, place].reshape(other, n, -1).sum(axis=1)
        np.testing.assert_allclose(across, whole[0].information[:other, own], rtol=1e-9, atol=1e-9 * summed.max())


def test_parts_are_blocks_of_times_and_folds_of_groups(with_gain: tuple[FitContext, Fitted]) -> None:
    context, fitted = with_gain
    parted = parted_block(context, fitted.values.active[0], fitted.values.active[0].used)
    times, train = parted.parts["times"][0, context.problem.train.times], context.problem.train
    assert np.all(np.diff(times[:, 0]) >= 0)
    assert set(np.bincount(times[:, 0]).tolist()) == {2}
    folds = parted.parts["baselines"][0, :, np.unique(context.problem.redundant.group[train.bls])].T
    assert np.all(folds == folds[0])
    assert np.ptp(np.bincount(folds[0])) <= 1


def test_a_gain_that_is_there_is_the_same_in_all_parts(with_gain: tuple[FitContext, Fitted]) -> None:
    context, fitted = with_gain
    for found in ask_constancy(context, fitted, [0])[0]:
        assert found.log_bayes_factor > 5
        assert found.spread < 0.3


@pytest.mark.parametrize(
    ("kind", "strength", "kept"), [("antenna_positions", 0.2, True), ("cross_coupling", 0.03, False)]
)
def test_a_gain_beside_what_is_not_in_the_model(kind: str, strength: float, kept: bool, tmp_path: Path) -> None:
    """What is left differs between parts, and so do gains beside it: by no more than errors that count with it.

    Where these are nearly as large as the gain, it is not claimed.
    """
    context = context_of(mock_job(GAIN, {"kind": kind, "strength": strength}), tmp_path)
    var = np.zeros(14)
    var[[4, 5]] = 0.05**2
    start = Active.start(AntennaGains(), context.setup, var, np.zeros((1, 14)))
    fitted = refit(context, Values((start,)))
    assert fitted.diagnostics.train_chi2[0] > 500
    found = ask_constancy(context, fitted, [0])[0]
    said = refusal_by_parts(found, context.problem.job.loop)
    if kept:
        assert said is None
        # By noise alone the gain had been taken back.
        by_noise = [replace(one, expected=one.expected_by_noise) for one in found]
        assert "between times" in str(refusal_by_parts(by_noise, context.problem.job.loop))
    else:
        assert "cannot be told from what is left" in str(said)


def test_a_place_is_not_what_a_gain_looks_like(tmp_path: Path) -> None:
    """With the true effect missing from the model another one fits in each part what is wrong there; it is taken back.

    An effect of the job itself is not asked.
    """
    context = context_of(mock_job(GAIN), tmp_path)
    positions = AntennaPositions()
    n = len(positions.parameters(context.setup))
    start = Active.start(positions, context.setup, np.full(n, 0.1**2), np.zeros((1, n)))
    fitted = refit(context, Values((start,)))
    checked = check(context, fitted)
    affected = Affected.of(checked.remains, context.setup.observation)
    found = ask_constancy(context, fitted, [0], affected)[0]
    assert min(one.log_bayes_factor for one in found) < 5
    assert max(one.expected_by_noise for one in found) > 50
    one = round_of(effect_candidate(positions), check(context, refit(context, Values())), checked)
    last, places, asked = take_back(context, one, 0)
    assert (places, asked) == ({0: None}, {0: found})
    assert last.after.fitted.values.active == ()
    assert last.after.score.chi2 == pytest.approx(one.before.score.chi2)
    assert "antenna positions: taken back, as it cannot be told from what is left beside it" in last.revised[0]
    assert take_back(context, one, 1) == (one, {0: 0}, {})


def test_what_is_the_least_the_same_is_taken_back_first(tmp_path: Path) -> None:
    """Beside what is not true others differ between parts, which are asked again without that."""
    context = context_of(mock_job(GAIN), tmp_path)
    wrong = []
    for effect, width in ((AntennaPointing(), 1.0), (AntennaPositions(), 0.1)):
        n = len(effect.parameters(context.setup))
        wrong.append(Active.start(effect, context.setup, np.full(n, width**2), np.zeros((1, n))))
    fitted = refit(context, Values(tuple(wrong)))
    checked, settings = check(context, fitted), context.problem.job.loop
    found = ask_constancy(context, fitted, [0, 1], Affected.of(checked.remains, context.setup.observation))
    assert all(refusal_by_parts(one, settings) for one in found.values())
    assert margin_of_parts(found[1], settings) < margin_of_parts(found[0], settings)
    one = round_of(effect_candidate(AntennaPositions()), check(context, refit(context, Values())), checked)
    last, places, _ = take_back(context, one, 0)
    assert places == {0: 0, 1: None}
    assert [one.kind for one in last.after.fitted.values.active] == ["antenna_pointing"]


def test_parts_of_what_comes_in_parts_are_asked_together() -> None:
    """The last one may be too faint to be the same everywhere; what has no parts is asked by itself."""

    def active(effect: Effect) -> Active:
        setup = small_setup()
        n = len(effect.parameters(setup))
        return Active.start(effect, setup, np.ones(n), np.zeros(n))

    clear, faint = Constancy("times", 90.0, 100.0, 0.1, 110.0), Constancy("times", -3.0, 7.0, 3.0, 8.0)
    others = Constancy("baselines", 2.0, 9.0, 1.0, 9.0)
    parts = (active(Diffuse()), active(Diffuse(12, l_min=7)), active(AntennaGains()))
    asked = as_one_of_parts(parts, {0: (clear,), 1: (faint, others), 2: (faint,)})
    assert asked[0] == asked[1] == (Constancy("times", 87.0, 107.0, 0.1, 118.0), others)
    assert asked[2] == (faint,)


def test_what_one_antenna_does_is_no_effect_of_the_sky(tmp_path: Path) -> None:
    """The phase of one antenna looks like refraction on all folds of baselines, but not on those without the antenna.

    An effect of the antenna itself is told by its own baselines alone, and is not asked by these parts.
    """
    context = context_of(mock_job({"kind": "antenna_gains", "parameters": {"antenna 2 phase": 0.3}}), tmp_path)
    start = check(context, refit(context, Values()))
    _, fitted = fit_candidate(context, start, Candidate.of(attribute(context, start.fitted, [Ionosphere()])[0]))
    affected = Affected.of(fitted.remains, context.setup.observation)
    assert affected is not None
    antennas = context.setup.observation.antenna_numbers[context.setup.observation.antenna_index]
    np.testing.assert_array_equal(affected.bls, (antennas == 2).any(axis=1))
    _, folds, few = ask_constancy(context, fitted.fitted, [0], affected)[0]
    assert folds.log_bayes_factor > 5
    assert few.log_bayes_factor < few.expected - 5
    said = refusal_by_parts([folds, few], context.problem.job.loop)
    assert "between the baselines of antenna 2, on which most of what is left lives, and the others" in str(said)
    var = np.zeros(14)
    var[[4, 5]] = 0.05**2
    gain = refit(context, Values((Active.start(AntennaGains(), context.setup, var, np.zeros((1, 14))),)))
    assert refusal_by_parts(ask_constancy(context, gain, [0], affected)[0], context.problem.job.loop) is None
    assert Affected.of(check(context, gain).remains, context.setup.observation) is None


@pytest.mark.parametrize("index", [0.0, 3.0])
def test_what_all_channels_have_is_asked_between_them(index: float, tmp_path: Path) -> None:
    """A flux that is wrong alike in all channels is the same in all; one whose spectrum is wrong is not.

    What every channel has for itself, as gains, is not asked.
    """
    freqs = tuple(131e6 + 3e6 * np.arange(4.0))
    plain = context_of(mock_job(freqs=freqs), tmp_path / "plain")
    flux = CatalogueFlux().foremost(plain.setup, 1)
    (name,) = flux.parameters(plain.setup).names
    errors = {name: 0.05, name.replace("relative flux error", "error of the spectral index"): index}
    spectrum = {"kind": "spectral_index", "settings": {"sources": [list(*flux.sources)]}, "parameters": errors}
    context = context_of(mock_job(spectrum, freqs=freqs), tmp_path / "wrong")
    fitted = refit(context, Values((Active.start(flux, context.setup, np.array([0.01]), np.zeros((4, 1))),)))
    parted = parted_block(context, fitted.values.active[0], np.arange(1))
    assert parted.parts["channels"][:, 0, 0].tolist() == [0, 1, 2, 3]
    of_channels = ask_constancy(context, fitted, [0])[0][2]
    assert of_channels.between == "channels"
    said = refusal_by_parts([of_channels], context.problem.job.loop)
    assert said is None if index == 0 else "differ between channels" in str(said)
    gains = Active.start(AntennaGains(), context.setup, np.full(14, 0.01), np.zeros((4, 14)))
    assert set(parted_block(context, gains, np.arange(14)).n_parts) == {"times", "baselines"}


def test_parameters_of_which_no_data_tell_are_neither_the_same_nor_not() -> None:
    """As of gains that jump where all has been flagged."""
    nothing = Likelihood(np.zeros((8, 8)), np.zeros(8), np.zeros((8, 8)))
    found = compare([nothing], STD, "times", 3.0, [1.0])
    assert (found.log_bayes_factor, found.expected, found.expected_by_noise) == (-3.0, -3.0, -3.0)


def test_many_parameters_have_fewer_parts(
    with_gain: tuple[FitContext, Fitted], monkeypatch: pytest.MonkeyPatch
) -> None:
    context, fitted = with_gain
    monkeypatch.setattr(parts, "MOST_COLUMNS", 13)
    assert parted_block(context, fitted.values.active[0], np.arange(6)).n_parts == {"times": 2, "baselines": 2}
    monkeypatch.setattr(parts, "MOST_COLUMNS", 11)
    found: tuple[Constancy, ...] = ask_constancy(context, fitted, [0])[0]
    assert found == ()
