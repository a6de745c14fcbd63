"""The joint fit of beams and effects is dense least squares of all of them at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.fit.accumulate import designs
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.heldout import variance_by_effects
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Active, Values
from tests.fit.test_gauss_newton import CASES, TWO, free
from tests.loop.mock import FREQ, context_of, mock_job


def design_of(share: RankData) -> ComplexArray:
    """Return the design of every row, (Nfreqs, Ntimes, Nbls, n)."""
    model = share.problem.forward_model(share.rows.groups)
    by_time = np.array(list(designs(share.rows, model, share.problem.basis, "", show=False)))
    return np.moveaxis(by_time[:, :, 0] + 1j * by_time[:, :, 1], 1, 0)[:, :, share.rows.member]


@dataclass
class Dense:
    """Least squares of all beams and parameters at once, on the data as they were read.

    ``model(f, x)`` gives C and E of channel f at the parameters in use of that channel.
    """

    context: FitContext
    values: Values
    model: Callable[[int, FloatArray], tuple[Any, Any]]

    def __post_init__(self) -> None:
        rows = self.context.train.rows
        self.design = design_of(self.context.train)
        self.data, self.root = rows.data, np.sqrt(2 * rows.inv_noise_var)
        self.shared = self.values.shared
        self.n_freqs, self.n_modes = len(self.data), self.design.shape[-1]

    def split(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return beams (Nfreqs, n) and parameters (Nfreqs, q) from all unknowns, in units of their priors."""
        beams, rest = np.split(p, [self.n_freqs * self.n_modes])
        common, own = np.split(rest, [int(self.shared.sum())])
        x = np.empty((self.n_freqs, len(self.shared)))
        x[:, self.shared], x[:, ~self.shared] = common, own.reshape(self.n_freqs, -1)
        mean = np.array([prior.mean for prior in self.context.problem.priors])
        std = np.array([prior.std() for prior in self.context.problem.priors])
        return mean + std * beams.reshape(self.n_freqs, -1), self.values.prior_std(0) * x

    def residuals(self, p: FloatArray) -> FloatArray:
        """Return whitened residuals, those of the priors, and what is held at zero."""
        beams, x = self.split(p)
        parts = []
        for f in range(self.n_freqs):
            factor, added = self.model(f, x[f])
            left = self.root[f] * (self.data[f] - factor * (self.design[f] @ beams[f] + added))
            parts += [left.real.ravel(), left.imag.ravel()]
        for one, span in zip(self.values.active, self.values.spans, strict=True):
            parts.append(1e5 * (x[:, span] / one.prior.of(0).std() @ one.degenerate_directions[:, one.used].T).ravel())
        return np.concatenate([*parts, p])

    def solve(self) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
        """Return beams, parameters, and the covariance of each channel's beam and parameters."""
        n_own = int(np.sum(~self.shared))
        n = self.n_freqs * (self.n_modes + n_own) + int(self.shared.sum())
        found = least_squares(self.residuals, np.zeros(n), method="lm", xtol=1e-14, ftol=1e-14)
        covariance = np.linalg.inv(found.jac.T @ found.jac)
        # The unknowns are linear in what they are made of.
        origin = np.concatenate([np.ravel(part) for part in self.split(np.zeros(n))])
        made = [np.concatenate([np.ravel(part) for part in self.split(unit)]) - origin for unit in np.eye(n)]
        to_all = np.array(made).T
        everything = to_all @ covariance @ to_all.T
        beams, x = self.split(found.x)
        q, edge = len(self.shared), self.n_freqs * self.n_modes
        channels = []
        for f in range(self.n_freqs):
            own = np.r_[f * self.n_modes : (f + 1) * self.n_modes, edge + f * q : edge + (f + 1) * q]
            channels.append(everything[np.ix_(own, own)])
        return beams, x, channels

    def predictive_variance(self, f: int, x: FloatArray, beam: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return the variance by beam and parameters of real and imaginary parts of held-out rows without C."""
        design = design_of(self.context.test)[f]
        factor, _ = self.model(f, x)

        def predict(step: FloatArray) -> ComplexArray:
            its_factor, added = self.model(f, x + step)
            return np.asarray(its_factor / factor * (design @ beam + added))

        steps = 1e-5 * np.diag(np.sqrt(np.diag(covariance)[len(beam) :]))
        by_x = [(predict(step) - predict(-step)) / (2 * step.sum()) for step in steps]
        jacobian = np.concatenate([design, np.moveaxis(by_x, 0, -1)], axis=-1)
        return np.array([np.sum((part @ covariance) * part, axis=-1) for part in (jacobian.real, jacobian.imag)])


def gain_factor(context: FitContext, amplitude: FloatArray, phase: FloatArray) -> Any:
    """Return g_j g_k* of each row."""
    one, two = antennas(context).T
    return np.exp(amplitude[one] + amplitude[two] + 1j * (phase[one] - phase[two]))


def antennas(context: FitContext) -> IntArray:
    """Return the antennas of each row in the sense of its group, (Nbls, 2)."""
    return context.setup.antenna_index[context.train.rows.tile.bls]


def all_gains(context: FitContext) -> tuple[list[Active], Callable[[int, FloatArray], tuple[Any, Any]]]:
    return [free(context, AntennaGains(), 0.1)], lambda f, x: (gain_factor(context, x[::2], x[1::2]), 0.0)


def couplings(context: FitContext) -> tuple[list[Active], Callable[[int, FloatArray], tuple[Any, Any]]]:
    pairs = [[1, 4], [0, 6]]
    rows = [_row(context, *pair) for pair in pairs]

    def model(f: int, x: FloatArray) -> tuple[Any, Any]:
        added = np.zeros(context.train.rows.data.shape[2], dtype=complex)
        added[rows] = x[::2] + 1j * x[1::2]
        return 1.0, added

    return [free(context, CrossCoupling(pairs), 1.0)], model


def several(context: FitContext) -> tuple[list[Active], Callable[[int, FloatArray], tuple[Any, Any]]]:
    """Gains of each channel, delays that channels share, and a coupling."""
    active = [
        free(context, AntennaGains(), 0.1, [0, 2, 9]),
        free(context, AntennaDelays(), 1.0, [4, 6]),
        free(context, CrossCoupling([[2, 6]]), 1.0),
    ]
    names = active[1].effect.parameters(context.setup).names
    assert [names[i] for i in (4, 6)] == ["antenna 2 delay", "antenna 3 delay"]
    row = _row(context, 2, 6)

    def model(f: int, x: FloatArray) -> tuple[Any, Any]:
        amplitude, phase, added = np.zeros(7), np.zeros(7), np.zeros(21, dtype=complex)
        amplitude[:2], phase[4], added[row] = x[:2], x[2], x[5] + 1j * x[6]
        turns = (context.setup.observation.freqs[f] - context.setup.reference_freq) * x[3:5] * 1e-9
        phase[[2, 3]] = 2 * np.pi * turns
        return gain_factor(context, amplitude, phase), added

    return active, model


def _row(context: FitContext, one: int, two: int) -> int:
    (row,) = np.flatnonzero(np.all(np.sort(antennas(context), axis=1) == [one, two], axis=1))
    return int(row)


SEVERAL = [
    {"kind": "antenna_gains", "parameters": {"antenna 0 ln amplitude": 0.1, "antenna 4 phase": -0.1}},
    {"kind": "antenna_delays", "parameters": {"antenna 2 delay": 0.2, "antenna 3 delay": -0.1}},
    {"kind": "cross_coupling", "settings": {"baselines": [[2, 6]]}, "parameters": {"baseline 2-6 real": 0.4}},
]


@pytest.mark.parametrize(
    ("make", "injected", "freqs"),
    [
        (all_gains, [CASES["antenna_gains"][0]], (FREQ,)),
        (couplings, [CASES["cross_coupling"][0]], (FREQ,)),
        (several, SEVERAL, TWO),
    ],
    ids=["nonlinear, something held", "linear", "several effects and channels"],
)
def test_the_fit_is_dense_least_squares(
    make: Any, injected: list[dict[str, Any]], freqs: tuple[float, ...], tmp_path: Path
) -> None:
    """Means and covariances of beams and effects, in whatever blocks they are solved for."""
    context = context_of(mock_job(*injected, freqs=freqs), tmp_path)
    active, model = make(context)
    fitted = refit(context, Values(tuple(active)))
    fit, values = fitted.fit, fitted.values
    dense = Dense(context, values, model)
    beams, x, covariances = dense.solve()
    found = values.x
    std = np.concatenate([std[:, one.used] for one, std in zip(values.active, fit.std, strict=True)], axis=1)
    n = beams.shape[1]
    results = channel_results(context, fitted)
    for f, covariance in enumerate(covariances):
        expected = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(found[f], x[f], atol=0.01 * expected[n:].min(), rtol=0)
        np.testing.assert_allclose(std[f], expected[n:], rtol=2e-3)
        scaled = np.outer(expected[n:], expected[n:])
        np.testing.assert_allclose(fit.covariances[f] / scaled, covariance[n:, n:] / scaled, atol=2e-3)
        posterior = fit.posteriors[f]
        assert np.all(np.abs(posterior.mean - beams[f]) < 0.01 * expected[:n])
        # Given the effects the beam is known better than with them free, which is what `infer` tells.
        assert np.all(posterior.std < expected[:n] * (1 + 1e-6))
        scaled = np.outer(expected[:n], expected[:n])
        np.testing.assert_allclose(results[f].posterior.covariance / scaled, covariance[:n, :n] / scaled, atol=2e-3)
        rows, added = context.test.calibrated(fitted.estimate)
        more, with_beam = variance_by_effects(context, fitted, rows, added)
        assert with_beam
        design = design_of(context.test)[f]
        by_beam = [np.sum((part @ posterior.covariance) * part, axis=-1) for part in (design.real, design.imag)]
        variance = dense.predictive_variance(f, x[f], beams[f], covariance)
        np.testing.assert_allclose(by_beam + more[f], variance, rtol=5e-3)
