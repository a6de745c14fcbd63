"""The numbers of held-out data are those that NumPy gives of data, weights and predictions, on any number of ranks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.predicted_power import squares_of_model
from hydrabeam_mpi.fit.state import Active, Fit, Values, independent_prior
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P, sigma_of_log_p
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.first_and_last import begin
from hydrabeam_mpi.loop.selection.heldout_numbers import SUMS, HeldoutNumbers
from hydrabeam_mpi.loop.selection.heldout_score import falls_of_blocks
from hydrabeam_mpi.loop.selection.predictions import check, is_at_noise
from hydrabeam_mpi.random import generator
from tests.loop.made import numbers
from tests.loop.mock import FREQ, context_of, mock_job

FREQS = (FREQ, FREQ + 8e6)


@pytest.fixture(scope="module")
def contexts(comm: MPI.Comm, tmp_path_factory: pytest.TempPathFactory) -> tuple[FitContext, FitContext]:
    """The same two channels of a small array shared out over all ranks, and whole on each."""
    job = mock_job(freqs=FREQS, prior={"widths": "stated"})
    shared = context_of(job, comm.bcast(tmp_path_factory.mktemp("numbers")), comm)
    return shared, context_of(job, tmp_path_factory.mktemp("alone"))


def with_gain(context: FitContext) -> tuple[HeldoutNumbers, HeldoutNumbers, Any]:
    """Numbers without effects, and of the same beams with one antenna's gain as known; and the fit."""
    first = begin(context, Values(), Clock())
    effect = AntennaGains()
    x = np.zeros((len(FREQS), len(effect.parameters(context.setup))))
    x[:, 4] = 0.3
    active = Active(
        effect,
        *independent_prior(np.zeros(x.shape[1]), effect.shared),
        x,
        np.full(x.shape[1], np.inf),
        np.zeros((0, x.shape[1])),
    )
    n_modes, n_local = context.problem.basis.n_modes, len(context.channels)
    known = Fit(
        first.last.fitted.fit.posteriors,
        (np.zeros((0, 0)),) * n_local,
        (np.zeros((n_modes, 0)),) * n_local,
        (np.zeros_like(x),),
    )
    fitted = replace(first.last.fitted, values=Values((active,)), fit=known)
    return first.last.numbers, check(context, fitted).numbers, fitted


@pytest.mark.mpi
def test_they_are_those_of_numpy_on_any_number_of_ranks(contexts: tuple[FitContext, FitContext]) -> None:
    """With a gain the residual is that of the data as read, d - C A b, and not of the data divided by it."""
    shared, alone = contexts
    found, (_, _, fitted) = with_gain(shared), with_gain(alone)
    rows = alone.test.rows
    antennas = alone.setup.antenna_index[rows.tile.bls]
    gain = np.exp(0.3 * (antennas == 2).sum(axis=1))
    w, d = rows.inv_noise_var, rows.data
    seen = alone.test.model_beam[:, :, rows.member]
    design = np.array(list(alone.test.designs(Values())))  # (Ntimes, Nfreqs, 2, Ngroups, n)
    parts = np.array([design[:, f] @ one.mean for f, one in enumerate(fitted.fit.posteriors)])
    beam = (parts[:, :, 0] + 1j * parts[:, :, 1])[:, :, rows.member]
    factors = [np.linalg.inv(one.factor) for one in fitted.fit.posteriors]
    variance = np.array([np.sum((design[:, f] @ root.T) ** 2, axis=(1, 3)) for f, root in enumerate(factors)])
    for made, factor in zip(found, (1.0, gain), strict=False):
        for channels, told in [(slice(None), made.of_all), *((slice(f, f + 1), made.of_channel(f)) for f in (0, 1))]:
            weight, data, model = w[channels], d[channels], seen[channels]
            residual = data - factor * beam[channels]
            scaled = np.concatenate([
                data[[f]] - model[[f]] * np.sum(weight[f] * model[f].conj() * data[f])
                / np.sum(weight[f] * np.abs(model[f]) ** 2) for f in range(len(data))
            ])  # fmt: skip
            power = np.sum(weight * np.abs(data) ** 2)

            def rms(x: Any, weight: Any = weight) -> float:
                return float(np.sqrt(np.sum(weight * np.abs(x) ** 2) / np.sum(weight)))

            wide = np.sum(weight * factor**2 * variance[channels][:, :, rows.member])
            expected = {
                "n": data.size,
                "rms": rms(residual),
                "rms_zero": rms(data),
                "rms_model": rms(data - model),
                "rms_model_scaled": rms(scaled),
                "rms_noise": np.sqrt(data.size / weight.sum()),
                "rms_expected": np.sqrt((data.size + wide) / weight.sum()),
                "explained": 1 - np.sum(weight * np.abs(residual) ** 2) / power,
                "explained_model": 1 - np.sum(weight * np.abs(data - model) ** 2) / power,
                "explained_model_scaled": 1 - np.sum(weight * np.abs(scaled) ** 2) / power,
                "noise_only_chi2": np.mean(weight * np.abs(residual) ** 2),
            }
            assert {key: told[key] for key in expected} == pytest.approx(expected, rel=1e-6)


def test_the_log_density_is_that_of_a_dense_gaussian(contexts: tuple[FitContext, FitContext]) -> None:
    """Of all rows together, with its determinant and all constants; chi^2 takes times by themselves."""
    alone = contexts[1]
    first = begin(alone, Values(), Clock())
    rows, told = alone.test.rows, first.last.numbers
    design = np.array(list(alone.test.designs(Values())))
    for f, posterior in enumerate(first.last.fitted.fit.posteriors):
        by_row = np.moveaxis(design[:, f][:, :, rows.member], 1, 0)  # (2, Ntimes, Nbls, n)
        data = np.stack([rows.data[f].real, rows.data[f].imag])
        noise = np.stack(2 * [0.5 / rows.inv_noise_var[f]])
        chi2 = 0.0
        for t in range(len(rows.tile.times)):
            power, _ = gaussian(posterior, by_row[:, t], data[:, t], noise[:, t])
            chi2 += 0.5 * power / rows.data[f].size
        density = -0.5 * sum(gaussian(posterior, by_row, data, noise))
        assert told.of_channel(f)["log_density"] == pytest.approx(density, rel=1e-6)
        assert told.of_channel(f)["predictive_chi2"] == pytest.approx(chi2, rel=1e-6)
    score = first.last.score
    assert told.of_all["predictive_chi2"] == pytest.approx(score.chi2, rel=1e-12)


def gaussian(posterior: Posterior, rows: FloatArray, data: FloatArray, noise: FloatArray) -> tuple[float, float]:
    """Return r^T C^-1 r and ln|2 pi C| of all parts of some rows, (..., n), with noise of variances."""
    flat = rows.reshape(-1, rows.shape[-1])
    spread = flat @ np.linalg.inv(posterior.factor).T
    covariance = np.diag(noise.ravel()) + spread @ spread.T
    left = data.ravel() - flat @ posterior.mean
    return float(left @ np.linalg.solve(covariance, left)), float(np.linalg.slogdet(2 * np.pi * covariance)[1])


@pytest.mark.parametrize("squares", [0.0, 5000.0])
def test_excess_is_told_in_standard_errors_of_what_noise_and_model_give(squares: float) -> None:
    """Draws of residuals whose model is uncertain in one direction of all data together."""
    n, rng = 2000, generator(5, "excess")
    direction = np.sqrt(squares**0.5 / (2 * n)) * np.ones(2 * n)
    sigmas = []
    for _ in range(2000):
        rows = rng.standard_normal(2 * n) + direction * rng.standard_normal()
        sums = {"n": n, "noise_only": 0.5 * np.sum(rows**2), "uncertain_only": 0.5 * np.sum(direction**2)}
        channels = np.array([[sums.get(name, 0.0)] for name in SUMS])
        sigmas.append(HeldoutNumbers(channels, np.zeros((2, 0)), np.zeros((2, 0))).excess_sigma(squares))
    assert np.mean(sigmas) == pytest.approx(0, abs=0.1)
    assert np.std(sigmas) == pytest.approx(1, abs=0.1)


def test_nothing_is_beyond_what_is_expected_of_no_data() -> None:
    empty = HeldoutNumbers(np.zeros((len(SUMS), 1)), np.zeros((2, 0)), np.zeros((2, 0)))
    assert empty.excess_sigma(0.0) == 0


@pytest.mark.mpi
def test_whether_a_residual_is_at_the_noise_is_told_by_what_errors_of_the_beam_have_in_common(
    contexts: tuple[FitContext, FitContext],
) -> None:
    context = contexts[0]
    made = begin(context, Values(), Clock()).last
    assert made.at_noise
    squares = context.grid.world.bcast(squares_of_model(context, made.fitted))

    def raised(sigmas: float) -> HeldoutNumbers:
        """By so many standard errors."""
        n, power, uncertain = (
            made.numbers.channels[SUMS.index(k)].sum() for k in ("n", "noise_only", "uncertain_only")
        )
        channels = made.numbers.channels.copy()
        more = sigmas * np.sqrt(n + 2 * uncertain + squares / 2) + n + uncertain - power
        channels[SUMS.index("noise_only")] += more / channels.shape[1]
        return replace(made.numbers, channels=channels)

    most = sigma_of_log_p(float(np.log(SIGNIFICANT_P)))
    assert raised(most - 0.1).excess_sigma(0.0) > most
    assert is_at_noise(context, made.fitted, raised(most - 0.1))
    assert not is_at_noise(context, made.fitted, raised(most + 0.1))


def test_a_rise_at_one_time_is_none_however_many_groups_it_is_in() -> None:
    """Groups are no draws of their own of what all of them have at one time."""
    before, after = numbers(3.0), numbers(3.3)
    assert after.rise_sigma(before) > 4
    times = before.times.copy()
    times[0, 5] += after.times[0].sum() - before.times[0].sum()
    assert replace(after, times=times).rise_sigma(before) == pytest.approx(1.0)


def test_a_rise_in_most_blocks_is_one_though_a_single_time_has_most_of_it() -> None:
    """That time widens the standard error as much as it adds to the rise; of ranks it is one of twenty."""
    before = numbers(3.0)
    rng = generator(3, "rises")

    def raised(mean: float) -> HeldoutNumbers:
        """By so many of their scatter in all blocks, and in one of each kind by a hundred more."""
        times, groups = before.times.copy(), before.groups.copy()
        for blocks in (times, groups):
            blocks[0] *= 1 + 0.01 * (mean + rng.standard_normal(blocks.shape[1]))
            blocks[0, 4] *= 2
        return replace(before, times=times, groups=groups)

    most = raised(2.0)
    assert min(falls_of_blocks([(most.times, before.times), (most.groups, before.groups)])) < 1.5
    assert most.rise_sigma(before) > RULES.decided_sigmas
    assert raised(0.0).rise_sigma(before) < RULES.decided_sigmas
    # Where they fall together, that most of them rise is none.
    times = most.times.copy()
    times[0, 4] = 0.0
    assert replace(most, times=times).rise_sigma(before) <= 0
