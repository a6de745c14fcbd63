"""Scales that a whole data set may have wrong: that of its fluxes, and that of its noise."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.config.text import frequency_text
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.inference.robust import LEAST_COUNT, STRONG, centre_and_spread, log_odds_of_wide
from hydrabeam_mpi.io.noise import MIN_DIFFERENCES
from hydrabeam_mpi.loop.checks.health_sums import Excess, Sums
from hydrabeam_mpi.setup.findings import Finding
from hydrabeam_mpi.setup.problem import Problem

CALIBRATED = 0.3
"""Spread of ln amplitude of calibrated data: flux scales of catalogues, beams, and skies without diffuse emission.

A factor of two is a matter of conventions, which have a check of their own.
"""
INCOMPLETE = 1.5
"""The same where the data are larger than the model, which may lack the Sun or the Galaxy: e^1.5 is no rare thing."""
UNCALIBRATED = 10.0
"""The same of data that nothing calibrates, in units of a correlator's choice: e^10 either way is common."""
KNOWN_NOISE = 0.2
"""Spread of ln noise power about what receivers and correlators promise."""
UNKNOWN_NOISE = 3.0
"""The same where a channel width, an integration time, an average or a unit is wrong: e^3 is one channel in sixteen."""
CLEAR_POWER = 10.0
"""Power of the model in a baseline's data, in units of what noise puts there: three standard deviations."""


def flux_scale(problem: Problem, sums: Sums) -> list[Finding]:
    """Find out whether the data are on another flux scale than the model: whether nothing calibrates them.

    The scale is taken baseline by baseline, each with a phase of its own, so that phases of antennas do not matter:

        s_b^2 = (|sum_t w d m*|^2 / sum_t w |m|^2 - 1) / sum_t w |m|^2,

    in which the one is what noise adds. The median of ln s_b, whose error is taken to be as large as baselines differ,
    is weighed under two priors: that of calibrated data and `UNCALIBRATED`.
    """
    logs = _log_scales(sums)
    if not logs.size:
        return []
    value, error = centre_and_spread(logs)
    odds = log_odds_of_wide(value, error, CALIBRATED if value < 0 else INCOMPLETE, UNCALIBRATED)
    if odds < STRONG:
        return []
    factor = float(f"{np.exp(-value):.4g}")
    coherent = float(np.median(np.abs(sums.scale)))
    return [
        Finding(
            "a wrong flux scale",
            "all data",
            f"data are {np.exp(value):.3g} times as large as the model beam's visibilities ({coherent:.3g} with one "
            f"phase for all baselines; log odds {odds:.0f} against a calibrated scale)",
            f"calibrate the data ([data] gains), or flux_scale = {factor * problem.job.data.flux_scale:.4g} in [data]",
            flux_scale=factor,
        )
    ]


def _log_scales(sums: Sums) -> FloatArray:
    """Return ln s of every baseline and channel, (Nknown,); nothing where most baselines do not follow the model."""
    overlap, model, _ = sums.bl_products
    known = model.real > 0
    power = np.where(known, model.real, 1.0)
    explained = (np.abs(overlap) ** 2 / power - 1)[known]
    if explained.size < LEAST_COUNT or np.median(explained) < CLEAR_POWER:
        return np.zeros(0)
    return 0.5 * np.log(np.maximum(explained, 1.0) / power[known])


def noise_level(problem: Problem, excess: Excess) -> list[Finding]:
    """Find out whether neighbouring times differ by what the noise's weights promise, where the sky moves little.

    Noise that is stated wrong is wrong by the same factor on all baselines: its error is taken to be as large as these
    differ.
    """
    total, n = excess.noise
    logs = total[n >= MIN_DIFFERENCES] / n[n >= MIN_DIFFERENCES]
    if len(logs) < LEAST_COUNT or problem.job.noise.kind == "time-differences":
        return []
    value, error = centre_and_spread(logs)
    odds = log_odds_of_wide(value, error, KNOWN_NOISE, UNKNOWN_NOISE)
    if odds < STRONG:
        return []
    ratio = float(np.exp(value))
    return [
        Finding(
            "noise unlike what its weights say",
            f"[noise] kind = '{problem.job.noise.kind}'",
            f"neighbouring times differ by {ratio:.3g} times the power that is expected (log odds {odds:.0f})",
            _remedy(problem, ratio),
        )
    ]


def _remedy(problem: Problem, ratio: float) -> str:
    other = "or kind = 'time-differences' in [noise]"
    if problem.job.noise.kind == "autocorrelations":
        width = float(np.median(problem.observation.channel_width)) / ratio
        stated = f"channel_width = '{frequency_text(float(f'{width:.4g}'))}' in [data]"
        return f"{stated} if the files are wrong about it, {other}"
    if problem.job.noise.sigma is not None:
        return f"sigma = {problem.job.noise.sigma * np.sqrt(ratio):.4g} (Jy) in [noise], {other}"
    return f"sigmas {np.sqrt(ratio):.3g} times as large in the noise's file, {other}"
