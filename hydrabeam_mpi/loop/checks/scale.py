"""Scales that a whole data set may have wrong: that of its fluxes, and that of its noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from hydrabeam_mpi.config.text import frequency_text
from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray
from hydrabeam_mpi.inference.robust import LEAST_COUNT, STRONG, centre_and_spread, log_odds_of_wide
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P
from hydrabeam_mpi.io.noise import MIN_DIFFERENCES
from hydrabeam_mpi.loop.checks.health_sums import Sums
from hydrabeam_mpi.setup.findings import Finding
from hydrabeam_mpi.setup.problem import Problem

CALIBRATED = 0.3
"""Spread of ln amplitude of calibrated data: flux scales of catalogues, beams, and skies without diffuse emission.

A factor of two is a matter of conventions, which have a check of their own.
"""
INCOMPLETE = 1.5
"""The same at most where the data are larger than the model, which may lack the Sun or the Galaxy.

e^1.5 is no rare thing; see `_width_if_larger` for a model that hardly lacks anything.
"""
UNCALIBRATED = 10.0
"""The same of data that nothing calibrates, in units of a correlator's choice: e^10 either way is common."""
KNOWN_NOISE = 0.2
"""Spread of ln noise power about what receivers and correlators promise."""
UNKNOWN_NOISE = 3.0
"""The same where a channel width, an integration time, an average or a unit is wrong: e^3 is one channel in sixteen."""
ROUNDING = 1e-6
"""Scales of channels that differ by less are the same."""
CLEAR_POWER = 10.0
"""Power of the model in a baseline's data, in units of what noise puts there: three standard deviations."""


def flux_scale(problem: Problem, sums: Sums) -> list[Finding]:
    """Find out whether the data are on another flux scale than the model: whether nothing calibrates them.

    The scale is taken baseline by baseline, each with a phase of its own, so that phases of antennas do not matter:

        s_b^2 = (|sum_t w d m*|^2 / sum_t w |m|^2 - 1) / sum_t w |m|^2,

    in which the one is what noise adds. The median of ln s_b, whose error is taken to be as large as baselines differ,
    is weighed under two priors: that of calibrated data and `UNCALIBRATED`. Data that do not follow the model, as they
    are conjugated for instance, have a small s_b whatever their scale: no scale is too small for being nearer to one
    than sqrt(sum_t w |d|^2 / sum_t w |m|^2), by which data as a whole are smaller than the model. Where channels differ
    beyond the errors of their medians each is weighed by itself, at the price of having so many.
    """
    channels = [_log_scales(one) for one in sums.bl_products.swapaxes(0, 1)]
    larger = _width_if_larger(sums.bl_products.sum(axis=2))
    known = np.concatenate(channels, axis=1) if channels else np.zeros((2, 0))
    if not known.size:
        return []
    if not _differ([one[0] for one in channels if one.size]):
        value, odds = _weighed(known, larger)
        scales, odds_of = np.array([np.exp(value)]), np.array([odds])
    else:
        found = [_weighed(one, larger) if one.size else (0.0, -np.inf) for one in channels]
        values, odds_of = np.array(found).T
        odds_of = odds_of - np.log(len(channels))
        # Of a channel that does not show the model nobody knows more than of the others.
        values = np.where(np.isfinite(odds_of), values, np.median(known[0]))
        odds_of = np.where(np.isfinite(odds_of), odds_of, np.max(odds_of))
        scales = np.where(odds_of < STRONG, 1.0, np.exp(values))
    wrong = odds_of >= STRONG
    return [_wrong_scale(problem, sums, scales, wrong, float(odds_of[wrong].min()))] if wrong.any() else []


def _wrong_scale(problem: Problem, sums: Sums, scales: FloatArray, wrong: BoolArray, odds: float) -> Finding:
    """Say that data are ``scales`` times as large as they should be, one or of each channel; ``wrong`` is as long."""
    factors = tuple(float(f"{one:.4g}") for one in 1 / scales)
    freqs = ", ".join(frequency_text(freq) for freq in problem.observation.freqs[wrong]) if not wrong.all() else ""
    sizes = dict.fromkeys(f"{one:.3g}" for one in (scales[wrong].min(), scales[wrong].max()))
    coherent = float(np.median(np.abs(sums.scale)))
    asked = [float(f"{one:.4g}") for one in np.multiply(factors, problem.job.data.flux_scale)]
    return Finding(
        "a wrong flux scale",
        f"channels at {freqs}" if freqs else "all data",
        f"data are {' to '.join(sizes)} times as large as the model beam's visibilities ({coherent:.3g} with one "
        f"phase for all baselines; log odds {odds:.0f} against a calibrated scale)",
        f"calibrate the data ([data] gains), or flux_scale = {asked[0] if len(asked) == 1 else asked} in [data]",
        flux_scale=factors,
    )


def _weighed(logs: FloatArray, larger: float) -> tuple[float, float]:
    """Return the median of ln s_b and the log odds that nothing calibrates such data; see `_log_scales`.

    ``larger`` is the spread of calibrated data that are larger than the model.
    """
    value, error = centre_and_spread(logs[0])
    if value > 0:
        return value, log_odds_of_wide(value, error, larger, UNCALIBRATED)
    largest, error_of_largest = centre_and_spread(logs[1])
    if largest > value:
        return value, log_odds_of_wide(min(largest, 0.0), error_of_largest, CALIBRATED, UNCALIBRATED)
    return value, log_odds_of_wide(value, error, CALIBRATED, UNCALIBRATED)


def _width_if_larger(products: ComplexArray) -> float:
    """Return the spread of ln s for calibrated data that are larger than the model.

    What makes them larger is sky that the model lacks. Of it no more is like the model's visibilities m, (s - 1) |m|,
    than is unlike them, q s |m|, what one complex scale for all baselines leaves. So s <= 1 / (1 - q): data that are
    the model's to a permille are not 50 times as large for want of a source.

    Parameters
    ----------
    products : ndarray, (3, Nfreqs)
        Those of `Sums`, of all baselines.
    """
    overlap, model, data = products
    followed = float(np.sum(np.abs(overlap) ** 2 / np.where(model.real > 0, model.real, 1.0)))
    left = max(float(np.sum(data.real)) - followed, 0.0)
    q = np.sqrt(left / followed) if followed > 0 else 1.0
    return float(min(INCOMPLETE, np.hypot(CALIBRATED, -np.log1p(-q)))) if q < 1 else INCOMPLETE


def _differ(channels: Sequence[FloatArray]) -> bool:
    """Whether channels, (N,) each, differ by more than the errors of their medians allow."""
    if len(channels) < 2:
        return False
    values, spreads = np.array([centre_and_spread(one) for one in channels]).T
    errors = np.sqrt(np.pi / 2) * np.maximum(spreads, ROUNDING) / np.sqrt([len(one) for one in channels])
    weights = errors**-2.0
    mean = np.sum(weights * values) / weights.sum()
    return bool(chdtrc(len(channels) - 1, np.sum(weights * (values - mean) ** 2)) < SIGNIFICANT_P)


def _log_scales(products: ComplexArray) -> FloatArray:
    """Return ln s of a channel's baselines and ln of the largest that it may be, (2, Nknown).

    Nothing where most of them do not follow the model. ``products``, (3, Nbls), are those of `Sums`.
    """
    overlap, model, data = products
    known = model.real > 0
    power = np.where(known, model.real, 1.0)
    explained = (np.abs(overlap) ** 2 / power - 1)[known]
    if explained.size < LEAST_COUNT or np.median(explained) < CLEAR_POWER:
        return np.zeros((2, 0))
    powers = np.array([np.maximum(explained, 1.0), np.maximum(data.real[known], 1.0)])
    return np.asarray(0.5 * np.log(powers / power[known]))


def noise_level(problem: Problem, *looks: FloatArray) -> list[Finding]:
    """Find out whether neighbouring times differ by what the noise's weights promise.

    Each of the ``looks``, (2, Nbls) sums and numbers of logs, has noise and what else moves beyond its expectation (sky
    that the model lacks, gains that drift): that which has less of it is believed. Noise that is stated wrong is wrong
    by the same factor on all baselines: its error is taken to be as large as these differ.
    """
    told = _log_noise(looks)
    if not told or problem.job.noise.kind == "time-differences":
        return []
    value, error = min(told)
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


def noise_ratio(*looks: FloatArray) -> float | None:
    """Return the noise's power over the stated one, by the looks of `noise_level`; None where none tells it."""
    told = _log_noise(looks)
    return float(np.exp(min(told)[0])) if told else None


def _log_noise(looks: Sequence[FloatArray]) -> list[tuple[float, float]]:
    """Return median and spread over baselines of ln noise power over what is stated, for each look that tells it."""
    logs = [total[n >= MIN_DIFFERENCES] / n[n >= MIN_DIFFERENCES] for total, n in looks]
    return [centre_and_spread(one) for one in logs if len(one) >= LEAST_COUNT]


def _remedy(problem: Problem, ratio: float) -> str:
    other = "or kind = 'time-differences' in [noise]"
    if problem.job.noise.kind == "autocorrelations":
        width = float(np.median(problem.observation.channel_width)) / ratio
        stated = f"channel_width = '{frequency_text(float(f'{width:.4g}'))}' in [data]"
        return f"{stated} if the files are wrong about it, {other}"
    if problem.job.noise.sigma is not None:
        return f"sigma = {problem.job.noise.sigma * np.sqrt(ratio):.4g} (Jy) in [noise], {other}"
    return f"sigmas {np.sqrt(ratio):.3g} times as large in the noise's file, {other}"
