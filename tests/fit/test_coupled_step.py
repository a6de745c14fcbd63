"""A step of effects with beams that hang together is the dense solution of all unknowns of all channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.channels import ChannelResult
from hydrabeam_mpi.fit.coupled_step import JointStep, _check_number
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.fit.settle import settle
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.inference.coupled import ChannelTold, CoupledEquations
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.over_frequency import modes_of, squared_exponential
from hydrabeam_mpi.random import complex_normal, generator
from tests.fit.test_gauss_newton import free
from tests.fit.test_joint_step import active, placed
from tests.loop.mock import context_of, mock_job

FREQS = np.array([130e6, 131e6, 134e6])
N_ROWS, N, OWN, SHARED = 30, 4, 2, 3


def as_real(matrix: ComplexArray) -> FloatArray:
    """Rows of unit noise, real parts above imaginary ones; the data's have E|n|^2 = 1."""
    return np.sqrt(2) * np.concatenate([matrix.real, matrix.imag])


@pytest.mark.parametrize("is_complex", [False, True])
def test_it_is_the_dense_solution(is_complex: bool) -> None:
    rng = generator(3, "step")
    modes = modes_of(squared_exponential(FREQS, 3e6))
    n_modes, q = modes.shape[1], OWN + SHARED
    values = placed(Values((active(AntennaGains(), OWN), active(AntennaDelays(), SHARED))), np.zeros((3, q)))
    widths = values.prior_std(0)
    rows = [complex_normal(rng, (N_ROWS, N)) for _ in FREQS]
    columns = [complex_normal(rng, (N_ROWS, q)) / widths * rng.uniform(0.1, 2, q) for _ in FREQS]
    data = [3 * complex_normal(rng, (N_ROWS,)) for _ in FREQS]

    kappa = 1.0 if is_complex else 2.0
    project = (lambda part: part) if is_complex else np.real
    equations = CoupledEquations(modes, N, is_complex)
    for f, (a, d) in enumerate(zip(rows, data, strict=True)):
        equations.add(f, ChannelTold(kappa * project(a.conj().T @ a), kappa * project(a.conj().T @ d)))
    beams = equations.solve()
    at = [one.mean for one in beams.moments(0, [])]
    likelihoods, across = [], []
    for a, s, d, mean in zip(rows, columns, data, at, strict=True):
        signal, left = 2 * (s.conj().T @ s).real, d - a @ mean
        likelihoods.append(Likelihood(signal, 2 * (s.conj().T @ left).real, signal))
        across.append(project(a.conj().T @ s))
    step = JointStep.of(values, beams, likelihoods, across)

    # All unknowns: modes (real and imaginary parts), the channels' own parameters, and those that they share.
    n_c, n_own = n_modes * N * (2 if is_complex else 1), OWN * len(FREQS)
    design, seen = [], np.zeros((len(FREQS), q, n_c + n_own + SHARED))
    of_beam: list[Array] = []
    for f, (a, s) in enumerate(zip(rows, columns, strict=True)):
        seen[f, :OWN, n_c + f * OWN : n_c + (f + 1) * OWN] = np.eye(OWN)
        seen[f, OWN:, n_c + n_own :] = np.eye(SHARED)
        to_beam = np.zeros((N, seen.shape[-1]), dtype=complex)
        parts = np.kron(modes[f], np.eye(N))
        to_beam[:, :n_c] = np.concatenate([parts, 1j * parts], axis=1) if is_complex else parts
        of_beam.append(to_beam)
        design.append(as_real(a @ to_beam + s @ seen[f]))
    prior = np.concatenate([np.full(n_c, 2.0 / kappa), np.tile(widths[:OWN], 3) ** -2, widths[OWN:] ** -2])
    whole = np.concatenate(design)
    covariance = np.linalg.inv(whole.T @ whole + np.diag(prior))
    mean = covariance @ whole.T @ np.concatenate([as_real(d) for d in data])

    unit = np.tile(widths, 3)
    stacked = seen.reshape(-1, seen.shape[-1])
    np.testing.assert_allclose(step.x / widths, (stacked @ mean).reshape(3, q) / widths, atol=1e-9)
    expected = stacked @ covariance @ stacked.T
    np.testing.assert_allclose(step.covariance / np.outer(unit, unit), expected / np.outer(unit, unit), atol=1e-10)
    for f, one in enumerate(step.channels(beams, step.x - values.x)):
        np.testing.assert_allclose(at[f] + one.moved, of_beam[f] @ mean, atol=1e-9)
        own, spread = seen[f] @ covariance @ seen[f].T, of_beam[f] @ covariance @ seen[f].T
        np.testing.assert_allclose(one.of_effects, step.covariance[f * q : (f + 1) * q, f * q : (f + 1) * q])
        np.testing.assert_allclose(one.response * widths, spread @ np.linalg.inv(own) * widths, atol=1e-8)
        left = of_beam[f] @ covariance @ of_beam[f].conj().T - spread @ np.linalg.inv(own) @ spread.conj().T
        np.testing.assert_allclose(one.covariance, left if is_complex else left.real, atol=1e-9)


def test_too_many_parameters_are_refused() -> None:
    values = placed(Values((active(AntennaGains(), 10),)), np.zeros((600, 10)))
    with pytest.raises(InputError, match="6000 parameters in all channels"):
        _check_number(values)


N_DRAWS = 400
GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06}}


@pytest.mark.parametrize("width", [0.0, 3.0])
def test_results_of_channels_that_hang_together(tmp_path: Path, width: float) -> None:
    """Those far apart are as independent ones; draws are of the posterior, with further coefficients in the beam."""

    def results_of(folder: Path, **frequency: object) -> list[ChannelResult]:
        job = mock_job(GAIN, freqs=(131e6, 132e6), n_times=6, prior={"frequency": frequency})
        context = context_of({**job, "output": {"draws": N_DRAWS}}, folder)
        gains, more = free(context, AntennaGains(), 0.1), free(context, BasisTruncation(), width)
        return channel_results(context, settle(context, refit(context, Values((gains, *([more] if width else []))))))

    alone = results_of(tmp_path / "alone", kind="independent")
    far = results_of(tmp_path / "far", kind="gaussian-process", length=1e3)
    near = results_of(tmp_path / "near", kind="gaussian-process", length=3e6)
    for one, two, three in zip(alone, far, near, strict=True):
        assert np.max(np.abs(one.posterior.mean - two.posterior.mean) / one.posterior.std) < 1e-7
        np.testing.assert_allclose(two.posterior.std, one.posterior.std, rtol=1e-7)
        np.testing.assert_allclose(two.arrays["effects_covariance"], one.arrays["effects_covariance"], rtol=1e-6)
        assert np.all(three.posterior.std < 1.001 * one.posterior.std)
        assert np.min(three.posterior.std / one.posterior.std) < 0.95
        assert two.heldout.summary() == pytest.approx(one.heldout.summary(), rel=1e-7)
    white = []
    for one in near:
        assert one.coupled is not None
        white.append((one.coupled.draws - one.posterior.mean) @ one.posterior.factor)
    n = white[0].shape[1]
    assert n == len(near[0].posterior.mean) > (24 if width else 23)
    for one in white:
        np.testing.assert_allclose(one.mean(axis=0), 0, atol=5 / np.sqrt(N_DRAWS))
        np.testing.assert_allclose(np.cov(one.T), np.eye(n), atol=6 / np.sqrt(N_DRAWS))
    # Those of the same number belong together.
    assert np.abs(white[0].T @ white[1] / N_DRAWS).max() > 6 / np.sqrt(N_DRAWS)
