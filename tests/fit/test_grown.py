"""A basis that got further functions: its beam is that of an inference with all of them from the start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.fit.channels import infer_channels
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.grown import beams_alone, grown_beam, grown_problem, growth_of, marginal_beams
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.fit.settle import settle
from hydrabeam_mpi.fit.state import Active, Fit, Fitted, Values
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.random import complex_normal, generator
from tests.fit.test_gauss_newton import TWO, free
from tests.loop.mock import context_of, mock_job

BASES: dict[str, dict[str, Any]] = {
    "Neumann": {"n_modes": 14, "k_max": 14, "m_max": 0, "boundary": "neumann"},
    "Dirichlet": {"n_modes": 14, "k_max": 14, "m_max": 0, "boundary": "dirichlet"},
    "Zernike": {"kind": "zernike", "max_degree": 4},
}


def context_with(basis: dict[str, Any], folder: Path, **changes: Any) -> FitContext:
    job = mock_job(freqs=TWO, **changes)
    return context_of({**job, "basis": basis}, folder)


def grown(context: FitContext, *more: Active) -> Fitted:
    """With the next modes, of which the first two are not in use, and then the modes after those."""
    one = BasisTruncation()
    two = BasisTruncation(len(one.parameters(context.setup)))
    n = len(one.parameters(context.setup))
    values = Values((free(context, one, 30.0, range(2, n)), *more, free(context, two, 10.0)))
    return settle(context, refit(context, values))


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_posterior_is_that_of_the_larger_basis(basis: dict[str, Any], tmp_path: Path) -> None:
    context = context_with(basis, tmp_path)
    fitted = grown(context)
    problem = grown_problem(context.problem, context.setup, fitted.values)
    n_more = sum(len(one.used) for one in fitted.values.active)
    assert problem.basis.n_modes == context.problem.basis.n_modes + n_more > 20
    whole = infer_channels(context.grid, problem, Clock())
    for one, two in zip(channel_results(context, fitted), whole, strict=True):
        assert np.all(np.abs(one.posterior.mean - two.posterior.mean) < 1e-5 * two.posterior.std)
        np.testing.assert_allclose(
            one.posterior.covariance / np.outer(two.posterior.std, two.posterior.std),
            two.posterior.covariance / np.outer(two.posterior.std, two.posterior.std),
            atol=1e-5,
        )
        assert one.posterior.log_evidence == pytest.approx(two.posterior.log_evidence, abs=1e-3)
        assert one.train_chi2 == pytest.approx(two.train_chi2, rel=1e-9)
        told = two.heldout.summary()
        # What the larger basis leaves of the model beam is not told of a basis that has grown.
        told.pop("heldout_rms_jy_beyond_basis")
        assert one.heldout.summary() == pytest.approx(told, rel=1e-5, abs=1e-7)


def test_other_effects_are_marginalised(tmp_path: Path) -> None:
    """Of the dense Gaussian of everything that the fit tells of a channel."""
    context = context_with(BASES["Neumann"], tmp_path)
    fitted = grown(context, free(context, AntennaGains(), 0.1))
    of_beam = np.concatenate([np.full(len(one.used), one.kind == "basis_truncation") for one in fitted.values.active])
    for f, beam in enumerate(marginal_beams(context.setup, fitted, context.channels)):
        given, follow, spread = (
            part[f] for part in (fitted.fit.posteriors, fitted.fit.beam_response, fitted.fit.covariances)
        )
        everything = np.block(
            [[given.covariance + follow @ spread @ follow.T, follow @ spread], [spread @ follow.T, spread]]
        )
        n = len(given.mean)
        kept = np.concatenate([np.arange(n), n + np.flatnonzero(of_beam)])
        expected = everything[np.ix_(kept, kept)]
        std = np.sqrt(np.diag(expected))
        np.testing.assert_allclose(beam.covariance / np.outer(std, std), expected / np.outer(std, std), atol=1e-6)
        np.testing.assert_array_equal(beam.mean[n:], fitted.values.x[f, of_beam])
        (alone,) = beams_alone(_of_channel(fitted, f).fit)
        np.testing.assert_allclose(alone.covariance, expected[:n, :n], rtol=1e-5, atol=1e-7 * expected[0, 0])


def _of_channel(fitted: Fitted, f: int) -> Fitted:
    fit = fitted.fit
    return replace(
        fitted,
        fit=replace(
            fit,
            posteriors=fit.posteriors[f : f + 1],
            covariances=fit.covariances[f : f + 1],
            beam_response=fit.beam_response[f : f + 1],
        ),
    )


def test_effects_see_the_whole_beam(tmp_path: Path) -> None:
    context = context_with(BASES["Dirichlet"], tmp_path)
    fitted = grown(context)
    za, az = np.linspace(0, 1.5, 20), np.linspace(0, 6, 20)
    rows, added = context.train.calibrated(fitted.estimate)
    _, block, _ = next(context.train.row_blocks(1, fitted.estimate, added[1], rows))
    (beam,) = marginal_beams(context.setup, _of_channel(fitted, 1), [1])
    basis = grown_problem(context.problem, context.setup, fitted.values).basis
    np.testing.assert_allclose(block.beam(za, az), basis.synthesize(beam.mean, za, az), atol=1e-12)
    known = context.problem.basis.synthesize(fitted.fit.posteriors[1].mean, za, az)
    assert np.abs(block.beam(za, az) - known).max() > 1e-6


def test_without_further_functions_nothing_changes(tmp_path: Path) -> None:
    context = context_with(BASES["Neumann"], tmp_path)
    values = Values((free(context, AntennaGains(), 0.1),))
    assert growth_of(context.setup, values) == []
    assert grown_problem(context.problem, context.setup, values) is context.problem
    mean = context.problem.priors[0].mean
    assert grown_beam(context.setup, values, 0, context.problem.basis, mean) == (context.problem.basis, mean)


@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
@pytest.mark.parametrize("n_known", [0, 2])
def test_effects_widen_the_beam_by_how_much_it_follows_them(is_complex: bool, n_known: int) -> None:
    """Of the covariance C of the effects by M C M^H, also where some of them are known exactly; the mean stays."""
    rng = generator(1, "beams alone", str(is_complex))

    def draw(*shape: int) -> np.ndarray:
        return complex_normal(rng, shape) if is_complex else rng.standard_normal(shape)

    root, response, errors = draw(6, 9), draw(6, 4), rng.standard_normal((4, 7))
    errors[:n_known] = 0.0
    posterior = Posterior(draw(6), np.linalg.cholesky(root @ root.conj().T), log_evidence=-3.0)
    (found,) = beams_alone(Fit((posterior,), (errors @ errors.T,), (response,)))
    expected = posterior.covariance + response @ errors @ errors.T @ response.conj().T
    np.testing.assert_allclose(found.covariance, expected, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_array_equal(found.mean, posterior.mean)
    assert found.log_evidence == -3.0


def test_without_effects_beams_are_as_they_are() -> None:
    posterior = Posterior(np.zeros(2), np.eye(2))
    assert beams_alone(Fit((posterior,))) == (posterior,)
