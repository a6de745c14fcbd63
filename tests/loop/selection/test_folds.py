"""Cross-validation: where one split of the data has not decided, the other fold is asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.config.effects import Loop
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, refit
from hydrabeam_mpi.fit.state import Active, Ended, Fitted, Values
from hydrabeam_mpi.loop.selection import folds
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.folds import compared, is_decided
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, gain_by_chance, gain_error, gain_of
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.random import generator
from tests.loop.mock import context_of, mock_job


def jd_of(context: FitContext, times: np.ndarray) -> list[list[float]]:
    """Single times as ranges."""
    return [[float(jd) - 1e-6, float(jd) + 1e-6] for jd in context.setup.observation.times[times]]


def with_and_without(context: FitContext, prior_std: float) -> tuple[Checked, Checked]:
    """Fits without a gain of antenna 3 and with it."""
    setup, effect = context.setup, AntennaGains()
    names = effect.parameters(setup).names
    prior_var = np.where(np.array(names) == "antenna 3 ln amplitude", prior_std**2, 0.0)
    gain = Active.start(effect, setup, prior_var, np.zeros((1, len(names))))
    fitted = refit(context, Values())
    return check(context, fitted), check(context, refit(context, Values((gain,)), fitted))


@pytest.mark.mpi
@pytest.mark.parametrize("n_times", [12, 3])
def test_the_other_fold_is_that_of_a_job_which_holds_out_what_was_fitted(
    n_times: int, comm: MPI.Comm, common_tmp_path: Path
) -> None:
    """Both folds count, with any number of ranks, some of which share the rows of a time where times are few."""
    injected = {"kind": "antenna_gains", "parameters": {"antenna 3 ln amplitude": 4e-4}}
    context = context_of(mock_job(injected, n_times=n_times), common_tmp_path / "one", comm)
    before, after = with_and_without(context, 1e-3)
    gain, error = gain_of(before.score, after.score), gain_error(before.score, after.score)
    assert not is_decided(gain, error, context.problem.job.loop), (gain, error)
    both = compared(context, before, after)
    swapped = mock_job(
        injected, n_times=n_times, holdout={"kind": "jd", "jd_ranges": jd_of(context, context.problem.train.times)}
    )
    swapped["holdout"].pop("every")
    other = context_of(swapped, common_tmp_path / "two", comm)
    np.testing.assert_array_equal(other.problem.test.times, context.problem.train.times)
    for one, asked, apart in zip((before, after), both, with_and_without(other, 1e-3), strict=True):
        assert asked.score.n_data == one.score.n_data + apart.score.n_data == 21 * n_times
        expected = one.score.log_density + apart.score.log_density
        assert asked.score.log_density == pytest.approx(expected, abs=0.02)
        power = one.numbers.channels + apart.numbers.channels
        np.testing.assert_allclose(asked.numbers.channels, power, rtol=1e-3)


def test_what_is_compared_with_several_is_fitted_to_the_other_fold_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = context_of(mock_job(n_times=12), tmp_path)
    before, one = with_and_without(context, 1e-3)
    two = with_and_without(context, 2e-3)[1]
    fitted: list[Values] = []

    def fit(context: FitContext, values: Values, start: Fitted) -> Fitted:
        fitted.append(values)
        return refit(context, values, start)

    monkeypatch.setattr(folds, "fit_patiently", fit)
    first = compared(context, before, one)
    assert fitted == [before.fitted.values, one.fitted.values]
    compared(context, before, two)
    again = compared(context, one, two)
    assert fitted == [before.fitted.values, one.fitted.values, two.fitted.values]
    assert again[0] is first[1]


def test_a_fit_of_the_other_fold_that_does_not_converge_says_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    context = context_of(mock_job(n_times=12), tmp_path)
    before, after = with_and_without(context, 1e-3)
    fits = []

    def stuck(context: FitContext, values: Values, start: Fitted) -> Fitted:
        fits.append(values)
        fitted = refit(context, values, start)
        return replace(fitted, diagnostics=replace(fitted.diagnostics, ended=Ended.STUCK))

    def without_beams(context: FitContext, values: Values, start: Fitted) -> Fitted:
        raise BrokenOff("no beams")

    monkeypatch.setattr(folds, "fit_patiently", stuck)
    for _ in range(2):
        assert compared(context, before, after) == (before, after)
    assert len(fits) == 2
    assert capsys.readouterr().err.count("do not converge") == 2
    monkeypatch.setattr(folds, "fit_patiently", without_beams)
    assert compared(context, replace(before), replace(after))[0].score is before.score


def test_a_clear_answer_is_not_asked_for_twice(tmp_path: Path) -> None:
    injected = {"kind": "antenna_gains", "parameters": {"antenna 3 ln amplitude": 0.05}}
    context = context_of(mock_job(injected, n_times=12), tmp_path)
    before, after = with_and_without(context, 0.1)
    assert compared(context, before, after) == (before, after)
    assert "exchanged" not in vars(context)


def test_the_error_of_a_gain_is_its_scatter_over_draws() -> None:
    """Of the difference of two predictions of the same data, in blocks."""
    rng = generator(5, "gain error")
    gains, errors = [], []
    n_times, n_groups = 40, 10
    for _ in range(400):
        z = rng.normal(size=(n_times, n_groups)) + 1j * rng.normal(size=(n_times, n_groups))
        shift = 0.2 * rng.normal(size=z.shape)
        one, two = (_score(0.5 * abs(z + part) ** 2) for part in (0.0, shift))
        gains.append(gain_of(one, two))
        errors.append(gain_error(one, two))
    assert np.mean(errors) == pytest.approx(np.std(gains), rel=0.3)


def test_what_changes_by_chance_is_told_from_blocks_that_get_worse() -> None:
    """Of two predictions that are as good as each other; what is there, in one group, does not count as chance."""
    rng = generator(6, "gain by chance")
    gains, chances = [], []
    n_times, n_groups = 40, 30
    for _ in range(400):
        z = rng.normal(size=(n_times, n_groups)) + 1j * rng.normal(size=(n_times, n_groups))
        one, two = (_score(0.5 * abs(z + 0.2 * rng.normal(size=z.shape)) ** 2) for _ in range(2))
        gains.append(gain_of(one, two))
        chances.append(gain_by_chance(one, two))
    assert np.mean(chances) == pytest.approx(np.std(gains), rel=0.2)
    wrong = z.copy()
    wrong[:, 4] += 3.0
    one, two = _score(0.5 * abs(wrong) ** 2), _score(0.5 * abs(z) ** 2)
    assert gain_of(one, two) < 2 * gain_error(one, two)
    assert gain_of(one, two) > 10 * gain_by_chance(one, two)


def _score(power: np.ndarray) -> HeldoutScore:
    n_times, n_groups = power.shape
    times = np.array([power.sum(axis=1), np.full(n_times, float(n_groups))])
    return HeldoutScore(times, np.array([power.sum(axis=0), np.full(n_groups, float(n_times))]), float(power.sum()))


def test_one_block_decides_nothing() -> None:
    score = _score(np.ones((1, 1)))
    assert gain_error(score, score) == np.inf
    assert not is_decided(1e9, np.inf, Loop())
    assert is_decided(np.nan, 1.0, Loop())


@pytest.mark.parametrize(("gain", "decided"), [(-13.1, True), (-12.9, False), (12.9, False), (13.1, True)])
def test_a_gain_or_a_loss_decides_from_two_standard_errors_beyond_what_is_asked_for(gain: float, decided: bool) -> None:
    assert is_decided(gain, 4.0, Loop(min_log_bayes_factor=5.0)) == decided
