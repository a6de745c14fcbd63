"""The joint fit of beams and effects: what was injected comes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.instrument.nonredundant_beams import NonredundantBeams
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.noise.noise_level import NoiseLevel
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit import gauss_newton, heldout
from hydrabeam_mpi.fit.beams_given import Solved, total_log_joint
from hydrabeam_mpi.fit.channels import infer_channels
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, Underway, refit, stepped
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.fit.state import Active, Ended, Estimate, Fitted, Reweighted, Values
from hydrabeam_mpi.fit.step import Step, take_step
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.heldout_score import heldout_score
from hydrabeam_mpi.result.summary import evaluate_on_grid
from tests.loop.mock import FREQ, context_of, mock_job, truth_of

TWO = (FREQ, FREQ + 8e6)


def free(context: FitContext, effect: Effect, width: float, only: Sequence[int] | None = None) -> Active:
    """Start at zero with a prior of ``width`` natural sizes for all parameters with a derivative, or only for some."""
    parameters = effect.parameters(context.setup)
    chosen = np.isin(np.arange(len(parameters)), np.arange(len(parameters)) if only is None else only)
    prior_var = np.where(chosen & ~parameters.nonlinear, (width * parameters.scale) ** 2, 0.0)
    return Active.start(effect, context.setup, prior_var, np.zeros(len(parameters)))


def heldout_chi2(context: FitContext, fitted: Fitted) -> float:
    """Return chi^2 of the held-out rows, of which nothing is kept: it is asked with one setting after another."""
    context = replace(context)
    return heldout_score(context, fitted).chi2


def beam_error(context: FitContext, fitted: Fitted, folder: Path) -> float:
    """Return the root mean square difference from the true beam of the first channel."""
    with h5py.File(folder / "truth.h5") as file:
        truth = file["beam"][0]
    found = evaluate_on_grid(lambda za, az: context.problem.basis.synthesize(fitted.fit.posteriors[0].mean, za, az))
    return float(np.sqrt(np.mean((found - truth) ** 2)))


# What is injected, by name; the effect that is fitted; and the prior's width in natural sizes.
GAINS = {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05, "antenna 5 phase": 0.04}
POSITIONS = {"antenna 1 displaced East": 0.08, "antenna 6 displaced North": -0.05, "antenna 3 displaced Up": 0.1}
COUPLING = {"baseline 1-4 real": 0.8, "baseline 1-4 imaginary": -0.5, "baseline 0-6 imaginary": 0.6}
CASES: dict[str, tuple[dict[str, Any], Effect, float]] = {
    "antenna_gains": ({"kind": "antenna_gains", "parameters": GAINS}, AntennaGains(), 0.1),
    "antenna_positions": ({"kind": "antenna_positions", "parameters": POSITIONS}, AntennaPositions(), 1.0),
    "cross_coupling": (
        {"kind": "cross_coupling", "settings": {"baselines": [[1, 4], [0, 6]]}, "parameters": COUPLING},
        CrossCoupling([[1, 4], [0, 6]]),
        1.0,
    ),
}


@pytest.mark.parametrize("freqs", [(FREQ,), TWO], ids=["one channel", "two channels"])
@pytest.mark.parametrize("kind", CASES)
def test_what_was_injected_comes_back(kind: str, freqs: tuple[float, ...], tmp_path: Path) -> None:
    injected, effect, width = CASES[kind]
    context = context_of(mock_job(injected, freqs=freqs), tmp_path)
    without = refit(context, Values())
    fitted = refit(context, without.values.extended(free(context, effect, width)), without)
    (truth,) = truth_of(tmp_path)
    names = effect.parameters(context.setup).names
    assert truth["kind"] == kind
    assert truth["names"] == list(names)
    (active,), (std,) = fitted.values.active, fitted.fit.std
    error = active.x - np.array(truth["values"])
    # What the data cannot tell is in the beam, or nowhere.
    held = effect.degenerate_directions(context.setup)
    error -= (error @ held.T) @ held
    assert error.shape == std.shape == (len(freqs), len(names))
    assert np.all(np.abs(error) < 4 * std)
    strong = np.abs(truth["values"]) > 0
    assert np.all(np.abs(np.array(truth["values"]))[strong] > 5 * std[strong]), "should be detectable"
    assert heldout_chi2(context, without) > 1.5
    assert heldout_chi2(context, fitted) < 1.4
    assert beam_error(context, fitted, tmp_path) < beam_error(context, without, tmp_path)


def test_a_fit_is_broken_off_where_it_is_not_worth_going_on(tmp_path: Path) -> None:
    """What is told of it says where it will end; one that goes on to the end is as if nobody had asked."""
    injected, effect, width = CASES["antenna_gains"]
    context = context_of(mock_job(injected), tmp_path)
    without = refit(context, Values())
    values = without.values.extended(free(context, effect, width))
    fitted = refit(context, values, without)
    told: list[Underway] = []

    def worth(at: Underway) -> bool:
        told.append(at)
        return True

    again = refit(context, values, without, worth=worth)
    np.testing.assert_array_equal(again.values.x, fitted.values.x)
    reached = total_log_joint(context, fitted.values, fitted.diagnostics.log_joint)
    ends = [at.reached + at.expected for at in told]
    assert ends[-1] == pytest.approx(reached, abs=0.01)
    assert abs(ends[0] - reached) < 0.1 * (reached - told[0].reached)
    assert {at.foreseen[0] for at in told} == {ends[0]}
    assert told[-1].foreseen[1] == pytest.approx(reached, abs=0.01)
    with pytest.raises(BrokenOff):
        refit(context, values, without, worth=lambda at: at.expected > 0.1)


def test_what_steps_promise_counts_as_far_as_those_before_have_kept_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    injected, effect, width = CASES["antenna_gains"]
    context = context_of(mock_job(injected), tmp_path)
    without = refit(context, Values())
    values = without.values.extended(free(context, effect, width))
    real, promised, told = gauss_newton.take_step, list[float](), list[float]()

    def bragging(context: FitContext, at: Estimate, solved: Solved) -> Step:
        step = real(context, at, solved)
        promised.append(1000 * step.gain)
        return replace(step, gain=promised[-1])

    def worth(at: Underway) -> bool:
        told.append(at.expected)
        return True

    monkeypatch.setattr(gauss_newton, "take_step", bragging)
    refit(context, values, without, worth=worth)
    assert told[0] == promised[0]
    # Of the first so many steps nothing is known, or of one that came before it.
    assert len(told) > gauss_newton.KEPT
    late = np.array(told[gauss_newton.KEPT :]) / promised[gauss_newton.KEPT : len(told)]
    assert np.all(late < 0.01)


def test_predictions_are_as_wide_where_columns_are_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each row has its own variance then; with too many parameters it is too large, as no beam follows them."""
    context = context_of(mock_job(freqs=TWO), tmp_path)
    without = refit(context, Values())
    fitted = refit(context, without.values.extended(free(context, BasisTruncation(), 10.0)), without)
    together = heldout_chi2(context, fitted)
    monkeypatch.setattr(heldout, "SHARED_BYTES", 0)
    apart = heldout_chi2(context, fitted)
    monkeypatch.setattr(heldout, "MAX_FOLLOWED", 0)
    alone = heldout_chi2(context, fitted)
    assert apart == pytest.approx(together, rel=0.25)
    assert alone < 0.6 * apart


@pytest.mark.parametrize("freqs", [(FREQ,), TWO], ids=["one channel", "two channels"])
def test_a_missing_source_is_found_where_it_is(freqs: tuple[float, ...], tmp_path: Path) -> None:
    """It is sought 0.8 degrees away, a third of the distance of candidates."""
    ra, dec, flux, bend = 130.0, -25.0, 2.0, 0.4
    values = {f"source at ra={ra:.3f} dec={dec:.3f}: flux": flux}
    if len(freqs) > 1:
        values[f"source at ra={ra:.3f} dec={dec:.3f}: change of spectral index"] = bend
    injected = {"kind": "missing_sources", "settings": {"sources": [[ra, dec]]}, "parameters": values}
    context = context_of(mock_job(injected, freqs=freqs), tmp_path)
    ra0, dec0 = ra + 0.7, dec - 0.5
    without = refit(context, Values())
    effect = MissingSources([(ra0, dec0)])
    start = free(context, effect, 1.0)
    start = replace(start, x=0.5 * (np.arange(start.x.shape[1]) == 0) * np.ones_like(start.x))
    fitted = refit(context, without.values.extended(start), without)
    (active,), (std,) = fitted.values.active, fitted.fit.std
    # Gnomonic projection about the place where it was sought.
    a, d, d0 = np.deg2rad([ra - ra0, dec, dec0])
    cosine = np.sin(d0) * np.sin(d) + np.cos(d0) * np.cos(d) * np.cos(a)
    east = np.rad2deg(np.cos(d) * np.sin(a) / cosine)
    north = np.rad2deg((np.cos(d0) * np.sin(d) - np.sin(d0) * np.cos(d) * np.cos(a)) / cosine)
    truth = np.array([flux, east, north, bend][: active.x.shape[1]])
    assert np.all(active.x == active.x[0])
    error = active.x[0] - truth
    assert np.all(np.abs(error) < 4 * std[0])
    assert std[0, 0] < flux / 10
    assert np.all(std[0, 1:3] < 0.2)
    assert heldout_chi2(context, without) > 1.5
    assert heldout_chi2(context, fitted) < 1.4


def test_without_effects_it_is_plain_inference(tmp_path: Path) -> None:
    """To rounding: there coefficients are counted from the prior's mean."""
    context = context_of(mock_job(freqs=TWO), tmp_path)
    fitted = refit(context, Values())
    plain = infer_channels(context.grid, context.problem, Clock())
    for f, (posterior, one, result) in enumerate(
        zip(fitted.fit.posteriors, plain, channel_results(context, fitted), strict=True)
    ):
        assert np.all(np.abs(posterior.mean - one.posterior.mean) < 1e-8 * posterior.std)
        np.testing.assert_array_equal(posterior.factor, one.posterior.factor)
        assert posterior.log_evidence == pytest.approx(one.posterior.log_evidence, abs=1e-3)
        assert result.heldout.summary() == pytest.approx(one.heldout.summary(), rel=1e-9)
        assert fitted.diagnostics.train_chi2[f] > 0.7


def test_it_comes_back_from_afar(tmp_path: Path) -> None:
    """A phase of more than a radian, from zero: no single step is linear."""
    injected = {"kind": "antenna_gains", "parameters": {"antenna 2 phase": 1.3, "antenna 5 ln amplitude": -0.5}}
    context = context_of(mock_job(injected), tmp_path)
    fitted = refit(context, Values((free(context, AntennaGains(), 1.0, [4, 5, 10, 11]),)))
    (active,), (std,) = fitted.values.active, fitted.fit.std
    truth = np.array(truth_of(tmp_path)[0]["values"])
    used = active.used
    assert used.tolist() == [4, 5, 10, 11]
    assert np.all(np.abs(active.x - truth)[:, used] < 4 * std[:, used])
    assert heldout_chi2(context, fitted) < 1.4


@pytest.mark.parametrize("left_out", [0, 4])
def test_phases_end_without_whole_turns(left_out: int, tmp_path: Path) -> None:
    """Where all antennas are free, so that what their phases have in common is held, and where some are not."""
    context = context_of(mock_job(CASES["antenna_gains"][0]), tmp_path)
    gains = free(context, AntennaGains(), 1.0, only=range(left_out, len(context.setup.antennas_in_use) * 2))
    near = refit(context, Values((gains,)))
    (start,) = near.values.active
    turns = np.zeros_like(start.x)
    turns[:, [5, 11]] = [2 * np.pi, -4 * np.pi]
    # What all have in common is held at zero from the beginning.
    held = start.degenerate_directions
    turns -= (turns @ held.T) @ held
    wide = replace(start, x=start.x + turns)
    found = refit(context, Values((wide,)), near)
    np.testing.assert_allclose(found.values.active[0].x, start.x, atol=1e-4)
    assert found.diagnostics.converged


def fitted_chi2(context: FitContext, fitted: Fitted) -> float:
    """Return chi^2 of the fitted rows of the first channel, with E as the fit's own beam sees it."""
    rows, added = context.train.calibrated(fitted.estimate)
    row_blocks = [block for _, block, _ in context.train.row_blocks(0, fitted.estimate, added[0], rows)]
    return float(sum(np.sum(block.weights * np.abs(block.residual) ** 2) for block in row_blocks))


@pytest.mark.parametrize("effect", [NonredundantBeams(), AntennaPositions()], ids=lambda effect: effect.kind)
def test_what_cannot_explain_the_data_makes_them_no_worse(effect: Effect, tmp_path: Path) -> None:
    """Gains that are badly wrong, and a beam that gives way: what is added changes as much as the beam does."""
    amplitudes = {f"antenna {i} ln amplitude": 0.5 * (-1) ** i for i in range(7)}
    injected = {"kind": "antenna_gains", "parameters": amplitudes | {"antenna 3 phase": 1.0}}
    context = context_of(mock_job(injected, prior={"kind": "fraction", "fraction": 1.0}), tmp_path)
    without = refit(context, Values())
    fitted = refit(context, without.values.extended(free(context, effect, 10.0)), without)
    assert fitted_chi2(context, fitted) < fitted_chi2(context, without)


def locked(values: Any) -> None:
    """Let no array that values are made of be written to any more."""
    if isinstance(values, np.ndarray):
        values.setflags(write=False)
    elif isinstance(values, tuple):
        for one in values:
            locked(one)
    elif is_dataclass(values):
        for field in fields(values):
            locked(getattr(values, field.name))


@pytest.mark.parametrize("every", [{"every": 3}, {"kind": "times", "every": 3}], ids=["baselines", "times"])
def test_a_fit_writes_to_nothing_that_it_is_given(every: dict[str, Any], tmp_path: Path) -> None:
    """Nor does the prediction of held-out rows, of which some parameters are fitted to the rows themselves."""
    context = context_of(mock_job(CASES["antenna_gains"][0], holdout=every), tmp_path)
    before = refit(context, Values((free(context, AntennaGains(), 0.1),)))
    locked(before)
    values = before.values.extended(free(context, CrossCoupling([[0, 1]]), 1.0))
    locked(values)
    after = refit(context, values, before)
    locked(after)
    assert heldout_chi2(context, after) < 1.4
    assert np.any(after.values.active[0].x != before.values.active[0].x)


def test_a_short_first_step_leads_to_the_same_place(tmp_path: Path) -> None:
    """As it is tried where a whole one did not converge; both fits say that they have."""
    context = context_of(mock_job(CASES["antenna_positions"][0]), tmp_path)
    without = refit(context, Values())
    values = without.values.extended(free(context, AntennaPositions(), 1.0))
    whole, short = (refit(context, values, without, first_step) for first_step in (1.0, RULES.first_step))
    assert whole.diagnostics.converged
    assert short.diagnostics.converged
    moved = np.abs(short.values.active[0].x - whole.values.active[0].x)
    assert np.all(moved <= 0.1 * whole.fit.std[0])


def test_a_fit_that_is_not_at_its_end_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hydrabeam_mpi.fit.gauss_newton.MAX_STEPS", 2)
    context = context_of(mock_job(CASES["antenna_positions"][0]), tmp_path)
    assert not refit(context, Values((free(context, AntennaPositions(), 1.0),))).diagnostics.converged


def test_weights_that_are_wrong_scale_the_errors(tmp_path: Path) -> None:
    """Noise twice as large as told."""
    context = context_of(mock_job(), tmp_path)
    plain = refit(context, Values((free(context, CrossCoupling([[0, 1]]), 1.0),)))
    scale = np.array([[2.0]])
    double = Reweighted(NoiseLevel(), scale, np.zeros_like(scale))
    scaled = refit(context, Values((free(context, CrossCoupling([[0, 1]]), 1.0),), (double,)))
    assert scaled.diagnostics.train_chi2[0] == pytest.approx(plain.diagnostics.train_chi2[0] / 4, rel=0.25)
    np.testing.assert_allclose(scaled.fit.std[0], 2 * plain.fit.std[0], rtol=0.05)
    data = [result.normal.n_data for result in channel_results(context, scaled)]
    assert data == [8 * 21]


@pytest.mark.mpi
def test_any_number_of_ranks_fits_the_same(comm: MPI.Comm, common_tmp_path: Path) -> None:
    """Two channels with effects that they share and that they do not."""
    injected = [CASES["antenna_gains"][0], CASES["antenna_positions"][0]]
    fits = []
    for name, world in (("all", comm), ("one", MPI.COMM_SELF)):
        folder = common_tmp_path / (name if world is comm else f"{name}{comm.rank}")
        context = context_of(mock_job(*injected, freqs=TWO, n_times=9), folder, world)
        values = Values((free(context, AntennaGains(), 0.1), free(context, AntennaPositions(), 1.0)))
        fits.append((context, refit(context, values)))
    (context, many), (_, one) = fits
    for number, (mine, other) in enumerate(zip(many.values.active, one.values.active, strict=True)):
        used, std = other.used, one.fit.std[number]
        assert np.all(np.abs(mine.x - other.x)[:, used] < 1e-6 * std[:, used])
        np.testing.assert_allclose(many.fit.std[number], std, rtol=1e-6)
    for channel, number in enumerate(context.channels):
        posterior, expected = many.fit.posteriors[channel], one.fit.posteriors[number]
        assert np.all(np.abs(posterior.mean - expected.mean) < 1e-6 * expected.std)


def test_an_effect_comes_back_from_its_description() -> None:
    effect = make_effect("missing_sources", MissingSources([(10.0, -30.0)], trials=50).describe())
    assert isinstance(effect, MissingSources)
    assert effect.sources == ((10.0, -30.0),)


def test_steps_that_go_too_far_are_shortened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To where no beam can be solved for; a fit that begins there is broken off, or an error where it was asked for.

    Parts of a step that leads nowhere do not either; damped steps go by what the data say where it begins.
    """
    context = context_of(mock_job(), tmp_path)
    sky, before = context.setup.sky, refit(context, Values())
    one = free(context, CatalogueFlux([np.rad2deg([sky.ra[0], sky.dec[0]]).tolist()]), 1.0)
    far = Values((replace(one, x=np.full((1, 1), 1e40)),))
    for fit in (refit, stepped):
        with pytest.raises(BrokenOff, match="no beams can be solved for"):
            fit(context, far, before)
    with pytest.raises(InputError):
        refit(context, far)
    usual, steps = refit(context, Values((one,)), before), []

    def too_far(*given: Any) -> Any:
        steps.append(take_step(*given))
        return replace(steps[-1], to=replace(steps[-1].to, values=far)) if len(steps) == 1 else steps[-1]

    monkeypatch.setattr(gauss_newton, "take_step", too_far)
    stuck = refit(context, Values((one,)), before)
    assert len(steps) == 1
    assert stuck.diagnostics.ended is Ended.STUCK
    assert stuck.values.x == 0

    # Not where nothing is expected of a step.
    steps.clear()
    monkeypatch.setattr(gauss_newton, "NEARLY_FLAT_NATS", 1e9)
    flat = refit(context, Values((one,)), before)
    assert flat.diagnostics.ended is Ended.FLAT
    assert flat.diagnostics.converged

    steps.clear()
    fitted = refit(context, Values((one,)), before, RULES.first_step)
    assert fitted.diagnostics.converged
    assert np.abs(fitted.values.x - usual.values.x).max() < 0.05 * usual.fit.std[0].max()
