"""The density of held-out rows, against that of one dense Gaussian of all of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.common_beam import CommonBeam
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.instrument.gain_jitter import GainJitter
from hydrabeam_mpi.effects.sky.ionosphere import Ionosphere
from hydrabeam_mpi.fit.accumulate import designs
from hydrabeam_mpi.fit.channels import infer_channels
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.local_parameters import fit_local, untold
from hydrabeam_mpi.fit.predicted_power import squares_of_model
from hydrabeam_mpi.fit.predictive_density import _factor_of, predictive_density
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.random import generator
from tests.fit.test_gauss_newton import CASES, TWO, free
from tests.loop.mock import FREQ, context_of, mock_job
from tests.loop.test_refit_dense import SEVERAL


def parts(rows: ComplexArray) -> FloatArray:
    """Real parts of all rows, then the imaginary ones."""
    return np.concatenate([rows.real.ravel(), rows.imag.ravel()])


def design_of(share: RankData) -> ComplexArray:
    """Of every row by the parts of the coefficients, (Nfreqs, Ntimes, Nbls, n), of complex ones the real first."""
    model, basis = share.problem.forward_model(share.rows.groups), share.problem.basis
    by_time = np.array(list(designs(share.rows, model, basis, "", show=False)))
    design = by_time if basis.is_complex else by_time[:, :, 0] + 1j * by_time[:, :, 1]
    design = np.moveaxis(design, 1, 0)[:, :, share.rows.member]
    return np.concatenate([design, 1j * design], axis=-1) if basis.is_complex else design


def coefficients_of(fitted: Fitted) -> FloatArray:
    """The parts of the beams' coefficients, (Nfreqs, n)."""
    means = [one.mean for one in fitted.fit.posteriors]
    return np.array([np.concatenate([one.real, one.imag]) if np.iscomplexobj(one) else one for one in means])


def parameters(fitted: Fitted) -> FloatArray:
    """Of all effects in use, (Nfreqs, q)."""
    return fitted.values.x if fitted.values.active else np.zeros((len(fitted.fit.posteriors), 0))


@dataclass(frozen=True)
class Dense:
    """Some rows of all channels, and how they follow all beams and parameters about some values of these."""

    share: RankData
    fitted: Fitted
    about: FloatArray

    def predicted(self, x: FloatArray) -> ComplexArray:
        """C (A b + E) of the rows with parameters (Nfreqs, q)."""
        at = replace(self.fitted, values=self.fitted.values.at(x)) if x.size else self.fitted
        factor, added = self.share.effects_of(at.estimate, at.values.active)
        return np.asarray(factor * (np.einsum("ftbn,fn->ftb", self.design, coefficients_of(self.fitted)) + added))

    @cached_property
    def design(self) -> ComplexArray:
        """See `design_of`."""
        return design_of(self.share)

    @property
    def root(self) -> FloatArray:
        """One over the standard deviation of the noise of each part."""
        return np.sqrt(2 * np.concatenate([self.share.rows.inv_noise_var.ravel()] * 2))

    def jacobian(self) -> FloatArray:
        """Of the parts over their noise, by the beams of all channels and the parameters of all channels."""
        design, (n_freqs, q) = self.design, self.about.shape
        factor = self.share.effects_of(self._moved.estimate, self._moved.values.active)[0]
        columns = []
        for f, n in np.ndindex(n_freqs, design.shape[-1]):
            one = np.zeros(design.shape[:-1], dtype=complex)
            one[f] = factor[f] * design[f, ..., n]
            columns.append(parts(one))
        for f, k in np.ndindex(n_freqs, q):
            step = np.zeros((n_freqs, q))
            step[f, k] = 1e-5 * self.fitted.values.prior_std(f)[k]
            change = self.predicted(self.about + step) - self.predicted(self.about - step)
            columns.append(parts(change) / (2 * step[f, k]))
        return self.root[:, np.newaxis] * np.stack(columns, axis=-1)

    @property
    def _moved(self) -> Fitted:
        values = self.fitted.values
        return replace(self.fitted, values=values.at(self.about) if self.about.size else values)


def posterior_of(context: FitContext, fitted: Fitted) -> FloatArray:
    """Covariance of all beams and parameters by the fitted rows and the priors, in one dense inverse."""
    values, x = fitted.values, parameters(fitted)
    jacobian = Dense(context.train, fitted, x).jacobian()
    n_beams = jacobian.shape[1] - x.size
    # Parameters that channels share are one number.
    numbers = np.arange(x.size).reshape(x.shape)
    numbers[:, values.shared] = numbers[0, values.shared]
    chosen, which = np.unique(numbers.ravel(), return_inverse=True)
    follow = block_diag(np.eye(n_beams), np.eye(len(chosen))[which])
    of_parameters = np.concatenate([values.prior_std(f) for f in range(len(x))])[chosen]
    of_beams = [prior.std() for prior in context.problem.priors]
    if context.problem.basis.is_complex:
        of_beams = [np.sqrt(0.5) * np.tile(one, 2) for one in of_beams]
    widths = np.concatenate([*of_beams, of_parameters])
    unknowns = jacobian @ follow
    return np.asarray(follow @ np.linalg.inv(unknowns.T @ unknowns + np.diag(widths**-2.0)) @ follow.T)


def of_one_gaussian(context: FitContext, fitted: Fitted, about: FloatArray) -> tuple[float, float, float]:
    """Misfit, spread and tr(M^2) of all held-out rows and channels in a model that is linear about some parameters."""
    rows = Dense(context.test, fitted, about)
    jacobian, posterior = rows.jacobian(), posterior_of(context, fitted)
    expected = np.zeros(jacobian.shape[1])
    expected[jacobian.shape[1] - about.size :] = (parameters(fitted) - about).ravel()
    residual = rows.root * parts(rows.share.rows.data - rows.predicted(about)) - jacobian @ expected
    of_model = jacobian @ posterior @ jacobian.T
    covariance = np.eye(len(residual)) + of_model
    misfit = float(0.5 * residual @ np.linalg.solve(covariance, residual))
    return misfit, float(0.5 * np.linalg.slogdet(covariance)[1]), float(np.sum(of_model**2))


GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.03}}


@pytest.mark.parametrize(
    ("make", "injected", "freqs", "changes", "rtol"),
    [
        (lambda one: [], [GAIN], TWO, {}, 1e-9),
        (lambda one: [free(one, CrossCoupling([[1, 4], [0, 6]]), 1.0)], [CASES["cross_coupling"][0]], TWO, {}, 1e-6),
        (
            lambda one: [
                free(one, AntennaGains(), 0.1, [0, 2, 9]),
                free(one, AntennaDelays(), 1.0, [4, 6]),
                free(one, CrossCoupling([[2, 6]]), 1.0),
            ],
            SEVERAL,
            TWO,
            {},
            1e-3,
        ),
        (
            lambda one: [free(one, CrossCoupling([[1, 4], [0, 6]]), 1.0), free(one, AntennaGains(), 0.1, [0, 2])],
            [CASES["cross_coupling"][0]],
            (FREQ,),
            {"holdout": {"kind": "baselines", "every": None, "antpairs": [[0, 6], [2, 3], [0, 5]]}},
            1e-3,
        ),
        (
            lambda one: [
                free(one, CrossCoupling([[1, 4], [0, 6]]), 1.0),
                free(one, AntennaDelays(), 1.0, [4, 6]),
            ],
            [CASES["cross_coupling"][0]],
            TWO,
            {"basis": {"form": "complex", "m_max": 2}},
            1e-3,
        ),
        (lambda one: [free(one, CommonBeam(), 1.0), free(one, AntennaGains(), 0.1, [0])], [GAIN], TWO, {}, 1e-3),
        (lambda one: [free(one, Ionosphere(), 0.5)], [GAIN], TWO, {}, 1e-3),
        (lambda one: [free(one, GainJitter([(2, "phase"), (3, "ln amplitude")]), 1.0)], [GAIN], TWO, {}, 1e-3),
    ],
    ids=[
        "beams alone",
        "linear",
        "several, some shared",
        "held-out baselines",
        "complex coefficients",
        "what beams have in common",
        "times' own, shared",
        "times' own",
    ],
)
def test_the_density_is_that_of_one_gaussian(
    make: Any, injected: list[dict[str, Any]], freqs: tuple[float, ...], changes: Any, rtol: float, tmp_path: Path
) -> None:
    """Of all held-out rows and channels, with what fitted rows and priors leave uncertain of beams and effects."""
    job = mock_job(*injected, freqs=freqs)
    for table, keys in changes.items():
        job[table] = {key: value for key, value in {**job[table], **keys}.items() if value}
    context = context_of(job, tmp_path)
    fitted = refit(context, Values(tuple(make(context))))
    local, about = untold(context, fitted.values), parameters(fitted)
    if local is not None:
        about = fit_local(context, fitted, local)[0].values.x
    density = predictive_density(context, fitted)
    found, expected = (
        (float(density.misfit.sum()), float(density.log_spread.sum())),
        of_one_gaussian(context, fitted, about),
    )
    np.testing.assert_allclose(found, expected[:2], rtol=rtol)
    if local is None:
        assert squares_of_model(context, fitted) == pytest.approx(expected[2], rel=max(rtol, 1e-5))


@pytest.mark.parametrize("form", ["real", "complex"])
def test_it_is_the_ratio_of_evidences(form: str, tmp_path: Path) -> None:
    """Of all rows and of those that are fitted."""
    context = context_of(mock_job(GAIN, basis={"form": form}), tmp_path)
    density, rows = predictive_density(context, refit(context, Values())), context.test.rows
    log_noise = float(np.log(rows.inv_noise_var[rows.inv_noise_var > 0] / np.pi).sum())
    everything = Tile(np.arange(context.setup.observation.Ntimes), context.problem.train.bls)
    problems = context.problem, replace(context.problem, train=everything)
    one, two = (infer_channels(context.grid, problem, Clock())[0].posterior.log_evidence for problem in problems)
    assert one is not None
    assert two is not None
    assert log_noise - density.misfit[0] - density.log_spread[0] == pytest.approx(two - one, rel=1e-9)


@pytest.mark.parametrize("size", [1.0, 1e12, 1e25])
def test_the_factor_of_a_signal_however_large(size: float) -> None:
    """Also of one that is negative by rounding, and beside which one is nothing."""
    root = generator(1, "signal").standard_normal((5, 2))
    exact = size * root @ root.T
    signal = exact - 1e-15 * size * np.eye(5)
    factor = _factor_of(signal)
    assert np.all(np.diag(factor) > 0)
    np.testing.assert_allclose(factor, np.tril(factor))
    np.testing.assert_allclose(factor @ factor.T, np.eye(5) + exact, rtol=0, atol=1e-12 * size)
    # What no signal is in has a variance of one.
    log_det = 2 * np.log(np.diag(factor)).sum()
    assert log_det == pytest.approx(np.linalg.slogdet(np.eye(2) + size * root.T @ root)[1], abs=0.5)
