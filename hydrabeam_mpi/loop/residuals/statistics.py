"""What is left, in numbers: chi^2 along every axis, correlations, tails, and how significant the worst of all is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, EARTH_RATE, FloatArray
from hydrabeam_mpi.inference.significance import (
    chi2_sigma,
    correlation_sigma,
    f_sigma,
    kurtosis_sigma,
    log_p_of_looks,
    log_p_two_sided,
    sigma_of_log_p,
)
from hydrabeam_mpi.loop.residuals.axes import Axis, Freedom, all_axes
from hydrabeam_mpi.loop.residuals.coherent import Coherence
from hydrabeam_mpi.loop.residuals.cube import Layout
from hydrabeam_mpi.loop.residuals.sums import ResidualSums

ALIKE = 1e-6
"""Significances that differ by less than this part of them are the same: sums over ranks are the same to 1e-9."""

MOST_LISTED = 64
LISTED_OF_MORE = 32
PAIRS = ("within redundant groups", "neighbouring times", "neighbouring channels")


@dataclass(frozen=True)
class Look:
    """The most significant entry of an axis."""

    axis: str
    what: Any
    sigma: float
    n_looks: int

    @property
    def log_p(self) -> float:
        """Natural log of the probability that noise gives so large a value anywhere on this axis."""
        return log_p_of_looks(float(log_p_two_sided(self.sigma)), self.n_looks)


def statistics(
    sums: ResidualSums, layout: Layout, n_shared: float = 0.0, coherent: Sequence[Coherence] = ()
) -> dict[str, Any]:
    """Return the statistics of whitened residuals, JSON-able.

    Parameters
    ----------
    sums : ResidualSums
        Of all ranks.
    layout : Layout
    n_shared : float, optional
        Number of fitted parameters that held-out rows share, or better the sum over their parts of the model's share
        of the predictive variance; see `axes.Freedom`.
    coherent : sequence of Coherence, optional
        What residuals have in common with the model.

    Returns
    -------
    dict
        ``overall``: {"chi2" (reduced), "n", "sigma"}. ``axes``: for each axis a list of {"what", "chi2", "sigma", "n"},
        all entries up to 64, else the 32 most significant. ``entries``: the number of entries of each axis.
        ``unevenness``: for each axis the significance of its entries differing. ``redundancy``: what
        redundant baselines have in common and what they have not, see `redundancy`. ``correlations``, ``tails``: of
        pairs of visibilities; kurtosis and the largest |z|. ``coherent``: of each kind the most significant {"kind",
        "what", "sigma", "n"} among n looks. ``looks``: their number. ``significance``: the most
        significant excess or structure of all, {"axis", "what", "sigma", "p", "log10_p", "corrected_sigma"} with p
        corrected for the looks: on its axis,
        then for the number of axes. ``n`` and ``sigma`` count complex data and Gaussian standard deviations.
    """
    freedom = Freedom.of(n_shared, sums.n)
    axes = all_axes(sums, layout)
    overall = {"chi2": _reduced(sums.chi2, sums.n), "n": round(sums.n), "sigma": _sigma(sums.chi2, sums.n, freedom)}
    shape = shape_looks(sums, axes, freedom)
    # Predictions may well be better than they claim, where the prior is wide: that is nothing missing.
    looks = [Look("overall", "all", max(overall["sigma"], 0.0), 1), *shape]
    looks += [largest_excess(axis, freedom) for axis in axes.values() if len(axis) > 1]
    looks += (like_model := [coherent_look(one, layout) for one in coherent])
    return {
        "overall": overall,
        "axes": {name: _listed(axis, freedom) for name, axis in axes.items()},
        "entries": {name: len(axis) for name, axis in axes.items()},
        "unevenness": {name: axis.unevenness(freedom) for name, axis in axes.items() if len(axis) > 1},
        "redundancy": redundancy(sums, freedom),
        "correlations": _correlations(sums, freedom),
        "tails": _tails(sums, layout, freedom),
        "coherent": [{"kind": one.axis, "what": one.what, "sigma": one.sigma, "n": one.n_looks} for one in like_model],
        "looks": sum(look.n_looks for look in looks),
        "significance": significance(looks),
        "n_shared": float(n_shared),
        "fringe_rates_aliased": _aliased(layout),
    }


def significance(looks: list[Look]) -> dict[str, Any]:
    """Return the most significant of some looks, one an axis, corrected for their number."""
    best = min(looks, key=lambda look: look.log_p)
    log_p = log_p_of_looks(best.log_p, len(looks))
    return {
        "axis": best.axis,
        "what": best.what,
        "sigma": best.sigma,
        "p": float(np.exp(log_p)),
        "log10_p": float(log_p / np.log(10)),
        "corrected_sigma": max(sigma_of_log_p(log_p), 0.0),
    }


def first_largest(values: FloatArray) -> int:
    """Return the number of the first value that is the largest but for rounding, which depends on who sums what.

    Two baselines of one group, for instance, differ from what they have in common by the same.
    """
    largest = values.max()
    return int(np.argmax(values >= largest - ALIKE * abs(largest)))


def most_significant(axis: Axis, freedom: Freedom, level: float = 1.0) -> Look:
    """Return the entry of an axis that differs most from a reduced chi^2."""
    sigma = axis.sigma(freedom, level)
    k = first_largest(np.abs(sigma))
    return Look(axis.name, axis.what[k], float(sigma[k]), len(axis))


def largest_excess(axis: Axis, freedom: Freedom, level: float = 1.0) -> Look:
    """Return the entry of an axis that exceeds a reduced chi^2 most."""
    sigma = axis.sigma(freedom, level)
    k = first_largest(sigma)
    return Look(axis.name, axis.what[k], max(float(sigma[k]), 0.0), len(axis))


def coherent_look(coherence: Coherence, layout: Layout, level: float = 1.0) -> Look:
    """Return what is most coherent with the model, where noise has variance ``level``."""
    sigma = coherence.sigma(level)
    k = first_largest(sigma)
    return Look(coherence.name, coherence.words(k, layout.observation), max(float(sigma[k]), 0.0), len(sigma))


def shape_looks(sums: ResidualSums, axes: dict[str, Axis], freedom: Freedom) -> list[Look]:
    """Return the looks that do not depend on the noise level: unevenness, correlations, kurtosis, largest residual."""
    # Entries too much alike, as after dividing by fitted scales, are no structure.
    uneven = {name: max(axis.unevenness(freedom), 0.0) for name, axis in axes.items() if len(axis) > 1}
    pairs = {entry["what"]: entry["sigma"] for entry in _correlations(sums, freedom)}
    found = [_best("unevenness", uneven), _best("correlations", pairs)]
    if sums.n > 1:
        # Tails that are too light are nothing missing.
        found.append(Look("kurtosis", "all", max(_kurtosis(sums, freedom)[1], 0.0), 1))
        scaled = sums.largest[0] / max(_reduced(sums.chi2, sums.n), 1e-300)
        found.append(Look("largest", "one visibility", sigma_of_log_p(-scaled / 2), max(round(sums.n), 1)))
    return [look for look in found if look is not None]


def _best(axis: str, sigmas: dict[str, float]) -> Look | None:
    """Return the entry that is most significant."""
    if not sigmas:
        return None
    what = max(sigmas, key=lambda name: abs(sigmas[name]))
    return Look(axis, what, sigmas[what], len(sigmas))


def _reduced(power: float, n: float) -> float:
    return float(power / (2 * n)) if n else 1.0


def _sigma(power: float, n: float, freedom: Freedom) -> float:
    return float(chi2_sigma(power / freedom.scale, 2 * n / freedom.scale)) if n else 0.0


def _listed(axis: Axis, freedom: Freedom) -> list[dict[str, Any]]:
    sigma, chi2 = axis.sigma(freedom), axis.chi2
    shown = np.arange(len(axis))
    if len(axis) > MOST_LISTED:
        shown = np.argsort(-np.abs(sigma), kind="stable")[:LISTED_OF_MORE]
    return [
        {"what": axis.what[k], "chi2": float(chi2[k]), "sigma": float(sigma[k]), "n": round(axis.n[k])}
        | (axis.extra[k] if axis.extra else {})
        for k in shown.tolist()
    ]


def redundancy(sums: ResidualSums, freedom: Freedom) -> dict[str, Any] | None:
    """Split chi^2 of redundant baselines into that of their common part and the rest; None without any.

    ``beyond_scatter`` is the significance of what they have in common being more than their scatter makes of a mean.
    """
    cells, common, n, power = sums.common.tolist()
    if not cells:
        return None
    rest = n - cells
    return {
        "common": {"chi2": _reduced(common, cells), "sigma": _sigma(common, cells, freedom), "n": round(cells)},
        "scatter": {
            "chi2": _reduced(power - common, rest),
            "sigma": _sigma(power - common, rest, freedom),
            "n": round(rest),
        },
        "beyond_scatter": _common_sigma(sums, freedom),
    }


def _correlations(sums: ResidualSums, freedom: Freedom) -> list[dict[str, Any]]:
    """Return correlation coefficients of pairs; significances do not depend on the scale of z.

    What rows share of the model's uncertainty correlates them by up to its share of the variance.
    """
    entries = []
    for kind, (what, (n, product, level)) in enumerate(zip(PAIRS, sums.pairs.tolist(), strict=True)):
        if n and level:
            correlation = product / level
            expected = float(np.clip(correlation, -freedom.share, freedom.share))
            moved = (correlation - expected) / max(1 - correlation * expected, 1e-12)  # difference of Fisher's z
            sigma = correlation_sigma(moved, n / freedom.scale) if kind else _common_sigma(sums, freedom)
            entries.append({"what": what, "correlation": correlation, "sigma": sigma, "n": round(n)})
    return entries


def _common_sigma(sums: ResidualSums, freedom: Freedom) -> float:
    """Return the significance of redundant baselines having more in common than their scatter explains.

    They have less in common where predictions are wider than they need be, which is nothing missing.
    """
    cells, common, n, power = sums.common.tolist()
    rest = n - cells
    if not power > common:
        return 0.0
    ratio = (common / cells) / ((power - common) / rest)
    ratio /= float(np.clip(ratio, 1 - freedom.share, 1 + freedom.share * n / cells))
    return max(f_sigma(ratio, (2 * cells / freedom.scale, 2 * rest / freedom.scale)), 0.0)


def _kurtosis(sums: ResidualSums, freedom: Freedom) -> tuple[float, float]:
    """Return n Sum |z|^4 / (Sum |z|^2)^2 - 2 and its significance."""
    excess = sums.n * float(sums.quartic[0]) / max(sums.chi2, 1e-300) ** 2 - 2
    return excess, kurtosis_sigma(excess, sums.n / freedom.scale)


def _tails(sums: ResidualSums, layout: Layout, freedom: Freedom) -> dict[str, Any]:
    """Return kurtosis and the largest residual with its place."""
    if not sums.n:
        return {}
    excess, sigma = _kurtosis(sums, freedom)
    power, f, t, b = sums.largest
    observation = layout.observation
    log_p = log_p_of_looks(-power / 2, sums.n)
    return {
        "kurtosis": {"excess": excess, "sigma": sigma},
        "largest": {
            "z": float(np.sqrt(power)),
            "corrected_sigma": sigma_of_log_p(log_p),
            "freq_hz": float(observation.freqs[f]),
            "jd": float(observation.times[t]),
            "baseline": observation.antpairs[b].tolist(),
        },
    }


def _aliased(layout: Layout) -> bool:
    """Tell whether the sky's fringe rates on the longest baseline go beyond what the times resolve."""
    values = layout.fringe_rates.values
    if not len(values):
        return False
    east_west = float(np.abs(layout.redundant.vectors[:, 0]).max())
    fastest = EARTH_RATE * east_west * float(layout.observation.freqs.max()) / C_M_PER_S
    return bool(fastest > np.abs(values).max())
