"""Scales that a whole data set may have wrong: that of its fluxes, and that of its noise."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.config.text import frequency_text
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.inference.robust import STRONG, log_odds_of_wide
from hydrabeam_mpi.loop.checks.bad_rows import LOG_STD
from hydrabeam_mpi.loop.checks.health_sums import Excess, Sums
from hydrabeam_mpi.setup.findings import Finding
from hydrabeam_mpi.setup.problem import Problem

CALIBRATED = 0.3
"""Spread of ln amplitude of calibrated data: flux scales of catalogues, beams, and skies without diffuse emission.

A factor of two is a matter of conventions, which have a check of their own.
"""
UNCALIBRATED = 10.0
"""The same of data that nothing calibrates, in units of a correlator's choice: e^10 either way is common."""
KNOWN_NOISE = 0.2
"""Spread of ln noise power about what receivers and correlators promise."""
UNKNOWN_NOISE = 3.0
"""The same where a channel width, an integration time, an average or a unit is wrong: e^3 is one channel in sixteen."""
MIN_SIGNIFICANCE = 10.0
"""Standard deviations by which the data must follow the model before a scale between them means anything."""
MIN_DIFFERENCES = 50
"""Fewer differences than this tell the noise's power to no better than a quarter."""


def flux_scale(problem: Problem, sums: Sums) -> list[Finding]:
    """Find out whether the data are on another flux scale than the model: whether nothing calibrates them.

    The scale is taken baseline by baseline, each with a phase of its own, so that phases of antennas do not matter:

        s^2 = sum_b (|sum_t w d m*|^2 / sum_t w |m|^2 - 1) / sum_b sum_t w |m|^2,

    in which the one is what noise adds. ln s is weighed under two priors, `CALIBRATED` and `UNCALIBRATED`.
    """
    logs, errors = _log_scales(sums)
    if not logs.size:
        return []
    value, error = float(np.median(logs)), float(np.median(errors))
    odds = log_odds_of_wide(value, error, CALIBRATED, UNCALIBRATED)
    if odds < STRONG:
        return []
    factor = float(f"{np.exp(-value):.4g}")
    coherent = np.abs(np.median(np.abs(sums.scale)))
    return [
        Finding(
            "a wrong flux scale",
            "all channels" if len(logs) > 1 else "",
            f"data are {np.exp(value):.3g} times as large as the model beam's visibilities ({coherent:.3g} with one "
            f"phase for all baselines; log odds {odds:.0f} against a calibrated scale)",
            f"calibrate the data ([data] gains), or flux_scale = {factor * problem.job.data.flux_scale:.4g} in [data]",
            flux_scale=factor,
        )
    ]


def _log_scales(sums: Sums) -> tuple[FloatArray, FloatArray]:
    """Return ln s and its error for every channel in which the data follow the model, each (Nknown,)."""
    overlap, model, _ = sums.bl_products
    logs, errors = [], []
    for of_channel, power in zip(overlap, model.real, strict=True):
        known = power > 0
        if not known.any():
            continue
        explained = np.abs(of_channel[known]) ** 2 / power[known] - 1
        if explained.sum() < MIN_SIGNIFICANCE * np.sqrt(np.count_nonzero(known)):
            continue
        square = explained.sum() / power[known].sum()
        scatter = np.sqrt(np.sum((explained - square * power[known]) ** 2)) / explained.sum()
        logs.append(0.5 * np.log(square))
        errors.append(0.5 * scatter)
    return np.array(logs), np.array(errors)


def noise_level(problem: Problem, excess: Excess) -> list[Finding]:
    """Find out whether neighbouring times differ by what the noise's weights promise, where the sky moves little."""
    total, n = excess.noise.sum(axis=1)
    if n < MIN_DIFFERENCES or problem.job.noise.kind == "time-differences":
        return []
    value, error = float(total / n), float(LOG_STD * np.sqrt(2 / n))
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
