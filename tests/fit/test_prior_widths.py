"""The widths of the beam's prior are those that have the most evidence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.prior_widths import adapted, as_stated
from hydrabeam_mpi.fit.scoring import Told
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.fit.width_numbers import WidthNumbers
from hydrabeam_mpi.fit.widths_evidence import ToldOfBeam, WidthsEvidence
from hydrabeam_mpi.inference.mode_widths import ModeSizes, PriorWidths
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import DiagonalPrior
from hydrabeam_mpi.random import complex_normal
from tests.loop.mock import context_of, mock_job

ORDERS = np.array([(k, m) for k in range(20) for m in range(6)])
SIZES = ModeSizes(np.exp(-np.random.default_rng(2).uniform(0, 8, len(ORDERS))), ORDERS, 1.0)
STATED = PriorWidths(0.1)
TRUE = PriorWidths(0.02, 0.01, (0.1, 0.4), True, (1.0, 0.3, 5.0, 1.0, 2.0, 0.5))
NUMBERS = WidthNumbers(np.bincount(ORDERS[:, 1]))


def normal(rng: np.random.Generator, shape: tuple[int, ...], is_complex: bool) -> Array:
    return complex_normal(rng, shape) if is_complex else rng.standard_normal(shape)


def linear_data(true: PriorWidths, is_complex: bool, seed: int = 5, n_shape: int = 0) -> dict[str, Any]:
    """Return a design and data of unit noise.

    Coefficients have widths ``true``, and beside that follow ``n_shape`` numbers together.
    """
    rng = np.random.default_rng(seed)
    design = 300 * normal(rng, (150, len(ORDERS)), is_complex)
    mean = normal(rng, (len(ORDERS),), is_complex)
    prior = DiagonalPrior.of(mean, SIZES, true)
    b = mean + prior.sigma * normal(rng, mean.shape, is_complex)
    shape = 0.3 * normal(rng, (len(ORDERS), n_shape), is_complex) if n_shape else None
    if shape is not None:
        b = b + shape @ normal(rng, (n_shape,), is_complex)
    return {"design": design, "data": design @ b + normal(rng, (150,), is_complex), "mean": mean, "shape": shape}


def log_density(made: dict[str, Any], widths: PriorWidths) -> float:
    """Return ln of the density of the data, as a Gaussian with all coefficients integrated over."""
    signal = made["design"] * DiagonalPrior.of(made["mean"], SIZES, widths).sigma
    if made["shape"] is not None:
        signal = np.hstack([signal, made["design"] @ made["shape"]])
    away = made["data"] - made["design"] @ made["mean"]
    # By singular values, as the covariance 1 + S S^H loses the digits of what is small beside its largest part.
    along, sizes, _ = np.linalg.svd(signal)
    variance = 1 + np.pad(sizes, (0, len(away) - len(sizes))) ** 2
    quadratic = np.sum(np.abs(along.conj().T @ away) ** 2 / variance)
    return float(-(quadratic + np.log(variance).sum()) * (1.0 if np.iscomplexobj(signal) else 0.5))


def channel_of(made: dict[str, Any], widths: PriorWidths) -> ToldOfBeam:
    """Return what a posterior with these widths tells."""
    design, prior = made["design"], DiagonalPrior.of(made["mean"], SIZES, widths, made["shape"])
    own = design.conj().T @ design
    precision = own.copy()
    prior.add_precision(precision)
    mean = np.linalg.solve(precision, design.conj().T @ made["data"] + prior.precision_times(prior.mean))
    return ToldOfBeam.of(own, Posterior(mean, np.linalg.cholesky(precision)), prior)


@pytest.mark.parametrize("n_shape", [0, 3])
@pytest.mark.parametrize("is_complex", [False, True])
def test_evidence_is_that_of_the_data(is_complex: bool, n_shape: int) -> None:
    """Against the density of the data themselves, whatever widths the posterior had."""
    made = linear_data(TRUE, is_complex, n_shape=n_shape)
    expected = log_density(made, TRUE) - log_density(made, STATED)
    assert expected > 50
    for at in (STATED, TRUE, PriorWidths(1.0, 1e-5, (0.0, 2.0))):
        channel = channel_of(made, at)
        one, two = (channel.at(widths, len(NUMBERS.of(widths))).value for widths in (TRUE, STATED))
        assert one - two == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("is_complex", [False, True])
def test_gradient_is_that_of_the_evidence(is_complex: bool) -> None:
    channel, numbers = channel_of(linear_data(TRUE, is_complex), STATED), NUMBERS.of(TRUE)
    step = 1e-5 * np.eye(len(numbers))

    def at(numbers: FloatArray) -> Told:
        return channel.at(NUMBERS.widths(numbers), len(numbers))

    slopes = [(at(numbers + one).value - at(numbers - one).value) / 2e-5 for one in step]
    np.testing.assert_allclose(at(numbers).slope, slopes, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("is_complex", [False, True])
def test_information_is_the_variance_of_the_gradient(is_complex: bool) -> None:
    """Over data whose coefficients have these widths."""
    numbers, n_data = NUMBERS.of(TRUE), 400
    told = [channel_of(linear_data(TRUE, is_complex, seed), TRUE).at(TRUE, len(numbers)) for seed in range(n_data)]
    slopes, expected = np.array([one.slope for one in told]), np.mean([one.information for one in told], axis=0)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(slopes.T @ slopes / n_data / scale, expected / scale, atol=5 / np.sqrt(n_data))


def beam_job(**changes: Any) -> dict[str, Any]:
    job = mock_job(n_times=24, basis={"n_modes": 120, "k_max": 24, "m_max": 4}, **changes)
    job["data"]["simulate"] |= {"nsamples": 100.0}
    return job


def widths_of(job: dict[str, Any], folder: Path, wider: bool = False) -> tuple[Any, Any]:
    folder.mkdir()
    context = context_of(job, folder)
    fitted = refit(context, Values())
    return context, adapted(context, fitted, WidthsEvidence(context, fitted).best(wider), wider=wider)


@pytest.mark.parametrize("stated", [0.003, 3.0])
def test_stated_widths_that_are_far_off_are_found_to_be(stated: float, tmp_path: Path) -> None:
    """Whichever they are, the same are found, and the log Bayes factor is the rise of what infer calls evidence."""
    context, (fitted, found) = widths_of(beam_job(prior={"fraction": stated}), tmp_path / "one")
    (prior,) = context.given(fitted.values).priors
    first = refit(context, Values()).fit.posteriors[0].log_evidence
    assert found.widths is not None
    assert found.log_bayes_factor > 20
    assert fitted.fit.posteriors[0].log_evidence - first > found.log_bayes_factor
    _, (other, _) = widths_of(beam_job(prior={"fraction": 1.0}), tmp_path / "two")
    sizes: list[FloatArray] = [one.fit.posteriors[0].std for one in (fitted, other)]
    assert abs(np.log(np.median(sizes[0] / sizes[1]))) < 0.2
    assert np.all(prior.std() > 0)


def test_adapted_widths_are_adapted_no_more_and_can_be_stated(tmp_path: Path) -> None:
    job = beam_job(prior={"fraction": 3.0})
    context, (fitted, found) = widths_of(job, tmp_path / "one")
    assert found.gain < 5.0
    again = context_of(beam_job(prior=as_stated(fitted.values.prior_widths)), tmp_path)
    np.testing.assert_array_equal(again.problem.priors[0].std(), context.given(fitted.values).priors[0].std())
    assert WidthsEvidence(again, refit(again, Values())).best().widths is None


def test_widths_that_may_only_grow_do_not_shrink(tmp_path: Path) -> None:
    context, (fitted, _) = widths_of(beam_job(prior={"fraction": 3.0}), tmp_path / "wide", wider=True)
    assert fitted.values.prior_widths is None
    context, (fitted, _) = widths_of(beam_job(prior={"fraction": 0.001}), tmp_path / "narrow", wider=True)
    assert fitted.values.prior_widths is not None
    assert np.all(context.given(fitted.values).priors[0].std() >= context.problem.priors[0].std())


def test_a_beam_that_is_its_model_keeps_a_width(tmp_path: Path) -> None:
    """The evidence is the same for all widths below what data can tell; the prior of the fraction decides."""
    job = beam_job(prior={"fraction": 1.0})
    del job["data"]["simulate"]["perturb"]
    context, (fitted, found) = widths_of(job, tmp_path / "exact")
    assert found.log_bayes_factor > 20
    (prior,) = context.given(fitted.values).priors
    assert np.all(prior.std() > 0)
    assert np.all(prior.std() < context.problem.priors[0].std())
    assert replace(fitted.values, prior_widths=None) == Values()


def test_azimuthal_orders_that_a_basis_lacks_cost_nothing() -> None:
    """A beam that is symmetric under reflections has no odd ones; a job may state factors of all of them."""
    numbers, without = WidthNumbers(np.array([3, 0, 4])), WidthNumbers(np.array([3, 4]))
    stated = PriorWidths(0.1, azimuthal=(1.0, 2.0, 0.5))
    price = numbers.price(numbers.of(stated))
    assert price == without.price(without.of(replace(stated, azimuthal=(1.0, 0.5))))
