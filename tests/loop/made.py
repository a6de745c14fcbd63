"""Candidates, fits and rounds as the loop has them, made by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.effects.noise.bad_integrations import BadIntegrations
from hydrabeam_mpi.effects.noise.noise_level import NoiseLevel
from hydrabeam_mpi.fit.state import Diagnostics, Fitted
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P, sigma_of_log_p
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound
from hydrabeam_mpi.loop.residuals.remains import Remains
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.heldout_numbers import SUMS, HeldoutNumbers
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore
from hydrabeam_mpi.random import generator

N_DATA = 2000
NOTHING = Fitted()


def evidence(
    log_bayes_factor: float, absorbed: float = 0.1, effective: float = 2.0, price: float = 9.0, **given: Any
) -> Evidence:
    """Of four parameters, three of which are in use and elements of their own, in one channel."""
    prior_var, gain = np.array([0.04, 0.01, 0.04, 0.0]), log_bayes_factor + price
    made = Evidence(log_bayes_factor, prior_var, np.zeros((1, 4)), 2 * log_bayes_factor, effective, absorbed, 3, gain)
    return replace(made, n_picked=3, **given)


def effect_candidate(
    effect: Effect, log_bayes_factor: float = 100.0, absorbed: float = 0.1, effective: float = 2.0, price: float = 9.0
) -> Candidate:
    found = evidence(log_bayes_factor, absorbed, effective, price)
    return Candidate(effect.kind, effect.title, log_bayes_factor, Finding(effect, found))


def weights_candidate(log_bayes_factor: float = 100.0, reason: str | None = None, n_freqs: int = 1) -> Candidate:
    """A noise scale of 1.5 +- 0.02 in every channel."""
    change = NoiseLevel()
    x, std = np.full((n_freqs, 1), 1.5), np.full((n_freqs, 1), 0.02)
    fit = ReweightingFit(log_bayes_factor, x, std, ("noise scale",), ("",), 210.0, 1, reason)
    return Candidate(change.kind, change.title, log_bayes_factor, weights=WeightsFound(change, fit, Fitted()))


def integrations_candidate(log_bayes_factor: float = 100.0) -> Candidate:
    """The second of three integrations is bad."""
    change, x = BadIntegrations(), np.array([[1.0, 20.0, 1.0]])
    fit = ReweightingFit(log_bayes_factor, x, 0.1 * (x > 1), ("a", "b", "c"), ("",) * 3, 210.0, 1)
    return Candidate(change.kind, change.title, log_bayes_factor, weights=WeightsFound(change, fit, Fitted()))


def blocks(chi2: float, log_spread: float = 0.0, n_times: int = N_DATA // 100, seed: int = 1) -> HeldoutScore:
    """A hundred data a time, and the same in ten groups."""
    rng = generator(seed, "blocks")
    axes = []
    for n_blocks in (n_times, 10):
        n = np.full(n_blocks, 100.0 * n_times / n_blocks)
        power = rng.gamma(n)
        axes.append(np.array([power * chi2 * n.sum() / power.sum(), n]))
    return HeldoutScore(axes[0], axes[1], float(axes[0][0].sum()), log_spread)


def numbers(rms: float, expected: float = 1.0, n_freqs: int = 2, n_data: int = N_DATA, seed: int = 3) -> HeldoutNumbers:
    """Data of 10 Jy rms with a noise of 1 Jy, which the model beam leaves at 5 Jy and at 4 Jy with its best scale.

    Blocks of times and groups scatter by a tenth about the same residual rms.
    """
    weight = float(n_data)
    sums = dict.fromkeys(SUMS, 0.0) | {
        "n": n_data, "weight": weight, "data": 100 * weight, "residual": rms**2 * weight, "noise": weight,
        "uncertain": (expected**2 - 1) * weight, "model_residual": 25 * weight, "overlap_real": 0.0,
        "overlap_imag": 84 * weight, "model": 84 * weight, "noise_only": rms**2 * weight,
        "uncertain_only": (expected**2 - 1) * weight, "predictive": (rms / expected) ** 2 * weight,
        "misfit": (rms / expected) ** 2 * weight,
    }  # fmt: skip
    rng, axes = generator(seed, "numbers"), []
    for n_blocks in (20, 10):
        of_block = np.full(n_blocks, weight / n_blocks)
        scatter = rng.normal(1, 0.1, n_blocks)
        axes.append(np.array([rms**2 * of_block * scatter / scatter.mean(), of_block]))
    channels = np.tile(np.array([sums[name] for name in SUMS])[:, np.newaxis] / n_freqs, n_freqs)
    return HeldoutNumbers(channels, axes[0], axes[1])


WHERE = {"sentence": "It is on antenna 5.", "antennas": {"state": "concentrated"}}


def checked(
    chi2: float,
    log_spread: float = 0.0,
    consistent: bool = False,
    white: bool = False,
    fitted: Fitted = NOTHING,
    train_chi2: FloatArray | None = None,
    rms: float | None = None,
    expected: float = 1.0,
    stands_out: str = "",
) -> Checked:
    """A fit with held-out data of this reduced chi^2, and of the rms that belongs to it if no other is given."""
    why = "it has no structure beyond chance" if white else "its times differ (9.0 sigma)"
    remains = Remains(consistent, white, why, {"overall": {"chi2": chi2}}, WHERE, {"largest": []}, (), stands_out)
    of_channels = np.array([chi2]) if train_chi2 is None else train_chi2
    effective, n_data = np.zeros_like(of_channels), np.full_like(of_channels, N_DATA)
    diagnostics = Diagnostics(of_channels, effective_parameters=effective, n_data=n_data)
    made, most = numbers(chi2**0.5 if rms is None else rms, expected), sigma_of_log_p(float(np.log(SIGNIFICANT_P)))
    fitted = replace(fitted, diagnostics=diagnostics)
    return Checked(fitted, blocks(chi2, log_spread), remains, made, made.excess_sigma(0.0) < most)


def round_of(candidate: Candidate, before: Checked, after: Checked, *ranking: Candidate) -> Round:
    """A round that moved the beam by a thousandth, with 12 sigma."""
    place = len(after.fitted.values.active) - 1 if candidate.finding else None
    return Round(candidate, (candidate, *ranking), before, after, sigma=12.0, beam_change=1e-3, place=place)
