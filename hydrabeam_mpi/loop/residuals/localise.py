"""Where a residual lives: on every axis the fewest entries that carry most of the excess, and a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P, chi2_sigma, log_p_two_sided, sigma_of_log_p
from hydrabeam_mpi.loop.residuals.axes import Axis, Freedom, all_axes
from hydrabeam_mpi.loop.residuals.coherent import OF_BASELINES, OF_TIMES, SPOTS, Coherence
from hydrabeam_mpi.loop.residuals.cube import Layout
from hydrabeam_mpi.loop.residuals.localise_words import of_redundancy, sentence
from hydrabeam_mpi.loop.residuals.statistics import Look, coherent_look, largest_excess, redundancy
from hydrabeam_mpi.loop.residuals.sums import ResidualSums

CARRIED = 2 / 3
COMPARABLE = 1 / 2
CONCENTRATED = 1 / 4
"""Fraction of an axis's entries, at most, that a concentrated excess lives in. Gaussian amplitudes everywhere would
have two thirds of their power in a third of the entries."""
MOST_LISTED = 64
CLEAR = 3.0
"""Significance from which on an entry has more than noise."""


@dataclass(frozen=True)
class Carriers:
    """The fewest entries of an axis that hold `CARRIED` of the excess, and those about as strong as the last of them.

    Attributes
    ----------
    entries : ndarray of int
        Strongest first.
    shares : ndarray
        Fraction of the excess that each adds.
    fewest : int
        How many it takes; the others are as strong as `COMPARABLE` times the last of these.
    """

    entries: IntArray
    shares: FloatArray
    fewest: int

    @classmethod
    def of(cls, entries: IntArray, shares: FloatArray) -> Carriers:
        """Choose from all entries, strongest first; both arguments are (Nentries,)."""
        reached = np.flatnonzero(np.cumsum(shares) >= CARRIED)
        fewest = int(reached[0]) + 1 if len(reached) else len(shares)
        weaker = np.flatnonzero(shares[fewest:] < COMPARABLE * shares[fewest - 1])
        count = fewest + int(weaker[0]) if len(weaker) else len(shares)
        return cls(entries[:count], shares[:count], fewest)


def where(
    sums: ResidualSums, layout: Layout, n_shared: float = 0.0, coherent: Sequence[Coherence] = ()
) -> dict[str, Any]:
    """Tell where the excess of chi^2 over its expectation lives.

    Parameters
    ----------
    sums : ResidualSums
        Of all ranks.
    layout : Layout
    n_shared, coherent : optional
        As in `statistics.statistics`. What follows the model tells antennas or baselines where chi^2 alone does not.

    Returns
    -------
    dict
        ``sentence``, and for each axis {"state", "of", "count", "sigma", "entries"}: ``state`` is "concentrated" (few
        of its ``of`` entries carry two thirds of the excess), "uneven" (they differ beyond chance, but it takes
        many) or "even"; ``sigma`` the significance of their differing; ``count`` the number of entries that carry
        two thirds. ``entries`` lists these and those about as strong as the weakest of them, up to 64, none if even,
        each as {"what", "chi2", "share", "sigma"}. The share of an antenna is that of its baselines that no antenna
        listed before it has. An axis told only by what follows the model has ``by``, the kind and the most
        significant one, and shares and significances of that.
    """
    freedom = Freedom.of(n_shared, sums.n)
    axes = all_axes(sums, layout)
    described: dict[str, Any] = {}
    found: dict[str, Carriers] = {}
    for name, axis in axes.items():
        if len(axis) > 1:
            carriers = _antenna_carriers(sums, layout, axis) if name == "antennas" else _carriers(axis, freedom)
            described[name] = _describe(axis, carriers, freedom, freedom.heavier(sums))
            found[name] = carriers
    # A noise that is larger at some times has more in common with anything there; so these times set the level.
    level = max(1.0, float(axes["times"].chi2.max(initial=1.0))) if "times" in axes else 1.0
    looks = [(coherent_look(one, layout, 1.0 if one.name in OF_TIMES else level), one) for one in coherent]
    for look, one in sorted(looks, key=lambda pair: pair[0].log_p):
        name = "baselines" if one.name in OF_BASELINES else "times" if one.name in OF_TIMES else "antennas"
        if look.log_p < np.log(SIGNIFICANT_P) and name in described and described[name]["state"] == "even":
            # Spots of all times are told by the single ones.
            single = next((two for two in coherent if two.name == SPOTS), one) if name == "times" else one
            _tell_coherent(single, look, layout, axes[name], described, found, 1.0 if name == "times" else level)
    chosen = {name: carriers.entries for name, carriers in found.items() if described[name]["state"] != "even"}
    words = sentence(axes, described, chosen, _of_few_baselines(layout, axes, chosen))
    words += "".join(f" It shows in {one['by']}." for one in described.values() if "by" in one)
    if shared := of_redundancy(redundancy(sums, freedom)):
        words += f" {shared}"
    return {"sentence": words, **described}


def _carriers(axis: Axis, freedom: Freedom) -> Carriers:
    """Choose among all entries, or among the clear ones where the others have together what noise has."""
    excess = axis.power - 2 * axis.n
    order = np.argsort(-excess, kind="stable")
    clear = axis.sigma(freedom) >= CLEAR
    if clear.any():
        power, n = float(axis.power[~clear].sum()), max(float(axis.n[~clear].sum()), 1.0)
        if chi2_sigma(power / freedom.scale, 2 * n / freedom.scale) < CLEAR:
            order = order[clear[order]]
    total = max(float(excess[order].sum()), float(excess[clear].sum()), 1.0)
    return Carriers.of(order, excess[order] / total)


def _antenna_carriers(sums: ResidualSums, layout: Layout, axis: Axis) -> Carriers:
    """Choose antennas one by one, each by the excess of those of its baselines that are not yet accounted for."""
    excess = sums.by_baseline[1] - 2 * sums.by_baseline[0]
    total = max(float(excess.sum()), float(np.max(axis.power - 2 * axis.n)), 1.0)
    numbers = layout.observation.antenna_numbers[layout.observation.antenna_index]
    place = {what: k for k, what in enumerate(axis.what)}
    index = np.array([[place.get(one, 0), place.get(two, 0)] for one, two in numbers.tolist()])
    left = excess.copy()
    entries: list[int] = []
    shares: list[float] = []
    for _ in range(len(axis)):
        by_antenna = np.bincount(index[:, 0], left, len(axis)) + np.bincount(index[:, 1], left, len(axis))
        by_antenna[entries] = -np.inf
        best = int(np.argmax(by_antenna))
        entries.append(best)
        shares.append(float(by_antenna[best]) / total)
        left[(index == best).any(axis=1)] = 0.0
    return Carriers.of(np.array(entries, dtype=int), np.array(shares))


def _tell_coherent(
    coherence: Coherence,
    look: Look,
    layout: Layout,
    axis: Axis,
    described: dict[str, Any],
    found: dict[str, Carriers],
    level: float,
) -> None:
    """Describe an axis by what of the residual follows the model or the sky, with noise of variance ``level``."""
    observation = layout.observation
    names = {
        "antennas": observation.antenna_numbers.tolist(),
        "baselines": observation.antpairs.tolist(),
        "times": observation.times.tolist(),
    }[axis.name]
    place = {str(what["jd"] if axis.name == "times" else what): k for k, what in enumerate(axis.what)}
    excess, sigma = np.zeros(len(axis)), np.zeros(len(axis))
    for index, over, significance in zip(
        coherence.index, coherence.chi2 - level * coherence.dof, coherence.sigma(level), strict=True
    ):
        k = place.get(str(names[index]))
        if k is None:  # a time that is fitted
            continue
        excess[k], sigma[k] = max(excess[k], over), max(sigma[k], significance)
    order = np.argsort(-excess, kind="stable")
    shares = excess[order] / max(float(excess[sigma >= CLEAR].sum()), float(excess.max()), 1e-300)
    carriers = Carriers.of(order, np.where(sigma[order] >= CLEAR, shares, 0.0))
    few = carriers.fewest <= np.ceil(CONCENTRATED * len(axis))
    described[axis.name] |= {"state": "concentrated" if few else "uneven", "count": carriers.fewest}
    described[axis.name] |= {"sigma": look.sigma, "entries": _listed(axis, carriers, sigma)}
    described[axis.name]["by"] = f"{look.axis}, {look.what}"
    found[axis.name] = carriers


def _describe(axis: Axis, carriers: Carriers, freedom: Freedom, heavier: Freedom) -> dict[str, Any]:
    sigma = _differing(axis, freedom)
    state = "even"
    if _beyond_chance(sigma) and carriers.fewest <= np.ceil(CONCENTRATED * len(axis)):
        state = "concentrated"
    elif _beyond_chance(_differing(axis, heavier)):
        # A large excess elsewhere scatters over this axis, too, by more than noise does.
        state = "uneven"
    entries = _listed(axis, carriers, axis.sigma(freedom)) if state != "even" else []
    return {"state": state, "of": len(axis), "count": carriers.fewest, "sigma": sigma, "entries": entries}


def _differing(axis: Axis, freedom: Freedom) -> float:
    """Return the significance of entries differing: of all together, or of the largest among so many."""
    if len(axis) < 2:
        return 0.0
    return max(axis.unevenness(freedom), sigma_of_log_p(largest_excess(axis, freedom, axis.level).log_p))


def _listed(axis: Axis, carriers: Carriers, sigma: FloatArray) -> list[dict[str, Any]]:
    """Return the entries that carry most, strongest first."""
    chi2 = axis.chi2
    return [
        {"what": axis.what[k], "chi2": float(chi2[k]), "share": float(share), "sigma": float(sigma[k])}
        | (axis.extra[k] if axis.extra else {})
        for k, share in zip(carriers.entries[:MOST_LISTED].tolist(), carriers.shares, strict=False)
    ]


def _beyond_chance(sigma: float) -> bool:
    return sigma > 0 and bool(log_p_two_sided(sigma) < np.log(SIGNIFICANT_P))


def _of_few_baselines(layout: Layout, axes: dict[str, Axis], chosen: dict[str, IntArray]) -> bool:
    """Tell whether to name baselines: whether fewer than half of the chosen antennas' baselines carry the excess."""
    if "baselines" not in chosen or "antennas" not in chosen:
        return "baselines" in chosen
    numbers = np.array(axes["antennas"].what)[chosen["antennas"]]
    touched = np.isin(np.array(axes["baselines"].what), numbers).any(axis=1).sum()
    return bool(len(chosen["baselines"]) < 0.5 * touched * CARRIED)
