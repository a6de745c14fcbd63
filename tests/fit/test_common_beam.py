"""Beams that are off alike: what is written of them, and what an error of the sky seems to explain of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.fit.beams_given import sum_for_beams
from hydrabeam_mpi.fit.common_widths import _CommonWidths
from hydrabeam_mpi.fit.equations import BEAM
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.grown import grown_beam, grown_problem
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.fit.prior_widths import adapted
from hydrabeam_mpi.fit.state import Estimate, Values
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.fit.widths_evidence import WidthsEvidence
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.rules import RULES, Rules
from hydrabeam_mpi.loop.selection import known_beforehand
from hydrabeam_mpi.loop.selection.heldout_numbers import heldout_numbers
from hydrabeam_mpi.loop.selection.known_beforehand import with_what_is_known
from tests.fit.test_gauss_newton import free
from tests.loop.mock import context_of, mock_job

THREE = (129e6, 131e6, 133e6)
EIGHT = tuple((120 + 2 * np.arange(8)) * 1e6)
BASES: dict[str, dict[str, Any]] = {
    "real": {"n_modes": 24, "k_max": 24, "m_max": 0},
    "complex": {"n_modes": 30, "k_max": 10, "m_max": 2, "form": "complex"},
}
PRIOR = {"kind": "fraction", "fraction": 0.1, "floor": 0.1}


def known(freqs: tuple[float, ...], folder: Path, **changes: Any):
    """Return a problem over several channels, and what a loop begins with."""
    context = context_of(mock_job(freqs=freqs, prior=PRIOR, **changes), folder)
    return context, with_what_is_known(context, Values())


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_beams_are_those_of_one_gaussian_of_all_channels(basis: dict[str, Any], tmp_path: Path) -> None:
    """With the prior covariance of coefficient n between channels f and g: sigma_fn^2 delta_fg + mean_f sigma_fn^2."""
    context, values = known(THREE, tmp_path, basis=basis)
    fitted = refit(context, values)
    normals = sum_for_beams(context, Estimate(Values(), ())).normals
    n, kappa = context.problem.basis.n_modes, 1 if context.problem.basis.is_complex else 2
    variances = np.array([prior.std() ** 2 for prior in context.problem.priors])
    priors = np.einsum("fg,fn->fgn", np.eye(3), variances) + variances.mean(axis=0)
    covariance = np.einsum("fgn,nm->fngm", priors, np.eye(n)).reshape(3 * n, 3 * n)
    precision = np.linalg.inv(covariance).astype(np.result_type(normals[0].own(BEAM)))
    means, score = np.concatenate([prior.mean for prior in context.problem.priors]), []
    for f, normal in enumerate(normals):
        own, prior = kappa * normal.own(BEAM), context.problem.priors[f]
        precision[f * n : (f + 1) * n, f * n : (f + 1) * n] += own
        score.append(kappa * normal.projection[BEAM] - own @ prior.mean)
    posterior = np.linalg.inv(precision)
    expected = means + posterior @ np.concatenate(score)
    std = np.sqrt(np.diag(posterior).real)

    problem = grown_problem(context.problem, context.setup, fitted.values)
    assert problem.basis is context.problem.basis
    whole = with_whole_beams(context, fitted)
    assert whole.values.active == ()
    for f, beam in enumerate(whole.fit.posteriors):
        own = slice(f * n, (f + 1) * n)
        assert np.all(np.abs(beam.mean - expected[own]) < 1e-6 * std[own])
        np.testing.assert_allclose(beam.std, std[own], rtol=1e-6)
        np.testing.assert_allclose(problem.priors[f].std() ** 2, np.diag(covariance)[own], rtol=1e-12)
        coeffs = grown_beam(context.setup, fitted.values, f, context.problem.basis, fitted.fit.posteriors[f].mean)[1]
        np.testing.assert_allclose(coeffs, beam.mean, atol=1e-14)


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_evidence_of_its_widths_is_that_of_one_gaussian_of_all_channels(basis: dict[str, Any], tmp_path: Path) -> None:
    """Of all data, as a function of the common part's prior, everything else marginalised."""
    context, values = known(THREE, tmp_path, basis=basis)
    (common,) = values.active
    normals = sum_for_beams(context, Estimate(Values(), ())).normals
    n, kappa = context.problem.basis.n_modes, 1 if context.problem.basis.is_complex else 2
    variances = np.array([prior.std() ** 2 for prior in context.problem.priors])

    def log_evidence(of_common: np.ndarray) -> float:
        priors = np.einsum("fg,fn->fgn", np.eye(3), variances) + of_common
        covariance = np.einsum("fgn,nm->fngm", priors, np.eye(n)).reshape(3 * n, 3 * n)
        own = block_diag(*(kappa * normal.own(BEAM) for normal in normals))
        means = [prior.mean for prior in context.problem.priors]
        score = np.concatenate(
            [
                kappa * (normal.projection[BEAM] - normal.own(BEAM) @ mean)
                for normal, mean in zip(normals, means, strict=True)
            ]
        )
        moved = np.linalg.solve(np.linalg.inv(covariance) + own, score)
        log_det = np.linalg.slogdet(np.eye(3 * n) + own @ covariance)[1]
        return float((2 / kappa) * 0.5 * (np.vdot(score, moved).real - log_det))

    fitted = refit(context, values)
    told = _CommonWidths(context, fitted, 0)
    mean = variances.mean(axis=0)
    (channel,) = told._channels
    for factor in (0.01, 0.3, 5.0):
        expected = log_evidence(factor * mean) - log_evidence(mean)
        found = channel.log_evidence(np.sqrt(factor * mean)) - told._here([])
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-3)
    assert common.kind == "common_beam"


def test_its_prior_gets_the_widths_that_the_data_want(tmp_path: Path) -> None:
    """A beam that is off by a tenth of what its prior expects is predicted better by one that expects that."""
    alike = {"kind": "common_beam", "strength": 0.01}
    job = mock_job(alike, freqs=EIGHT, n_times=6, prior=PRIOR, basis={"n_modes": 120, "k_max": 24, "m_max": 4})
    job["data"]["simulate"] |= {"perturb": {"stretch": [1.0, 1.0], "sidelobe": 0.0}, "nsamples": 0.01}
    context = context_of(job, tmp_path)
    before = refit(context, with_what_is_known(context, Values()))
    after, _ = adapted(context, before, WidthsEvidence(context, before).best())
    (one,), (two,) = before.values.active, after.values.active
    ratio = np.median(two.prior.of(0).std() / one.prior.of(0).std())
    assert 0.02 < ratio < 0.5
    rms = [heldout_numbers(context, fitted).of_all for fitted in (before, after)]
    assert rms[1]["rms"] < rms[0]["rms"]
    assert rms[1]["log_density"] > rms[0]["log_density"] + 10
    assert rms[1]["predictive_chi2"] == pytest.approx(1, abs=0.15)


def test_other_effects_are_known_as_before(tmp_path: Path) -> None:
    """Of the dense Gaussian of everything that the fit tells of a channel."""
    context, values = known(THREE, tmp_path)
    fitted = refit(context, values.extended(free(context, AntennaGains(), 0.1)))
    whole, n = with_whole_beams(context, fitted), context.problem.basis.n_modes
    assert [one.kind for one in whole.values.active] == ["antenna_gains"]
    np.testing.assert_array_equal(whole.fit.std[0], fitted.fit.std[1])
    n_common = fitted.values.active[0].size
    for f, beam in enumerate(whole.fit.posteriors):
        given, follow, spread = (
            part[f] for part in (fitted.fit.posteriors, fitted.fit.beam_response, fitted.fit.covariances)
        )
        follow = follow + np.eye(n, len(spread))
        beams, across = given.covariance + follow @ spread @ follow.T, (follow @ spread)[:, n_common:]
        own = spread[n_common:, n_common:]
        response = across @ np.linalg.inv(own)
        np.testing.assert_allclose(whole.fit.covariances[f], own, rtol=1e-12)
        np.testing.assert_allclose(whole.fit.beam_response[f], response, atol=1e-6 * np.abs(response).max())
        left = beams - response @ across.T
        std = np.sqrt(np.diag(left))
        np.testing.assert_allclose(beam.covariance / np.outer(std, std), left / np.outer(std, std), atol=1e-6)


def test_held_out_data_are_predicted_by_the_whole_beams(tmp_path: Path) -> None:
    context, values = known(THREE, tmp_path)
    fitted = refit(context, values)
    rows = context.test.rows
    for channel, result in enumerate(channel_results(context, fitted)):
        predicted = [
            (one[channel, 0] + 1j * one[channel, 1]) @ result.posterior.mean for one in context.test.designs(values)
        ]
        residual = rows.data[channel] - np.array(predicted)[:, rows.member]
        weights = rows.inv_noise_var[channel]
        noise_only = np.sum(weights * np.abs(residual) ** 2) / np.count_nonzero(weights)
        assert result.heldout.summary()["heldout_chi2_noise_only"] == pytest.approx(noise_only, rel=1e-9)


def test_what_all_channels_share_is_no_error_of_the_sky(tmp_path: Path) -> None:
    """Few times tell a source's flux hardly from a beam, which eight channels of their own would not have by chance."""
    alike = {"kind": "common_beam", "strength": 0.1}
    job = mock_job(alike, freqs=EIGHT, n_times=6, prior=PRIOR, basis={"n_modes": 120, "k_max": 24, "m_max": 4})
    job["data"]["simulate"] |= {"perturb": {"stretch": [1.0, 1.0], "sidelobe": 0.0}, "nsamples": 0.01}
    context, flux = context_of(job, tmp_path), make_effect("catalogue_flux", {})
    weighed = []
    for values in (Values(), with_what_is_known(context, Values())):
        (found,) = attribute(context, refit(context, values), [flux])
        weighed.append(found.evidence.log_bayes_factor)
    assert weighed[0] > 100
    assert weighed[1] < 0


def test_what_is_known_is_left_out_where_the_job_says_so(tmp_path: Path) -> None:
    context, values = known(THREE, tmp_path)
    assert [one.kind for one in values.active] == ["common_beam"]
    assert with_what_is_known(context, values) is values
    job = context.problem.job
    for other in (
        job.model_copy(update={"loop": job.loop.model_copy(update={"skip": ("common_beam",)})}),
        job.model_copy(update={"prior": job.prior.model_copy(update={"widths": "stated"})}),
    ):
        without = replace(context, problem=replace(context.problem, job=other))
        assert with_what_is_known(without, Values()).active == ()
    (tmp_path / "one").mkdir()
    alone, values = known(THREE[:1], tmp_path / "one")
    assert values.active == ()
    assert alone.setup.observation.Nfreqs == 1


def test_of_large_bases_the_widest_are_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known_beforehand, "RULES", replace(RULES, most_known=10))
    context, values = known(THREE, tmp_path)
    (common,) = values.active
    variances = np.mean([prior.std() ** 2 for prior in context.problem.priors], axis=0)
    assert common.size == 10
    assert set(common.used.tolist()) == set(np.argsort(-variances, kind="stable")[:10].tolist())
    assert Rules().most_known == 512
