"""The few elements (antennas, sources) that explain what an effect leaves: which they are, by marginal likelihood.

Elements are taken one by one, the one first that raises the evidence most beside those before. Where the beam or each
other element can take up most of what one does, a false one may come first as it stands for several. So they are also
left out one by one, the worst first, beginning with all of them; the better set is taken. Widths are re-estimated on
the way (sparse Bayesian learning: Tipping and Faul 2003).
"""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Parameters
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.likelihood import RANK_RTOL
from hydrabeam_mpi.inference.matrices import inverse_hermitian
from hydrabeam_mpi.loop.attribution.price import rarity
from hydrabeam_mpi.loop.rules import RULES

TAUS: FloatArray = np.exp(np.linspace(np.log(1e-7), np.log(1e4), 160))
"""Prior widths tried, in units of an effect's natural scale."""
TRIED_AT_ONCE = 32
"""Elements that are tried with all widths together: enough to take little longer than one."""

Scaled = tuple[FloatArray, FloatArray]
"""K and u of parameters in units of their natural scale, of each block, (Nblocks, q, q) and (Nblocks, q)."""


def few_elements(scaled: Scaled, parameters: Parameters, tau: float) -> tuple[float, FloatArray]:
    """Return ln BF and the width of each element, (Nelements,), zero where it is not taken.

    ``tau`` is the width that all of them have together at best.
    """
    n = int(parameters.element.max()) + 1
    can = np.bincount(parameters.element, weights=parameters.scale > 0, minlength=n) > 0
    forward = _forward(scaled, parameters, can)
    left = _backward(scaled, parameters, np.where(can, tau, 0.0))
    if np.array_equal(left, forward[1] > 0) or not left.any():
        return forward
    return max(forward, _forward(scaled, parameters, left), key=lambda found: found[0])


def _forward(scaled: Scaled, parameters: Parameters, can: BoolArray) -> tuple[float, FloatArray]:
    """Take the elements that ``can`` be, (Nelements,), one by one; return as `few_elements` does."""
    members = _members(parameters)
    working = scaled
    widths = np.zeros(len(members))
    log_bayes_factor = 0.0 if can.any() else -np.inf
    for n_taken in range(min(len(members), max(4, len(members) // 2))):
        free = np.flatnonzero(can & (widths == 0))
        if not len(free):
            break
        place, gain, tau = _best_element(working, members[free], rarity(parameters, TAUS))
        best = free[place]
        # The k elements may be picked in any order.
        gain += np.log(n_taken + 1) - np.log(max(parameters.trials - n_taken, 1)) - 1.0
        if n_taken and gain < RULES.element_nats:
            break
        log_bayes_factor += gain
        widths[best] = tau
        if gain <= 0:
            break
        chosen = members[best][members[best] >= 0]
        working = _condition(working, chosen, tau)
    return log_bayes_factor, widths


def _backward(scaled: Scaled, parameters: Parameters, widths: FloatArray) -> BoolArray:
    """Begin with elements of these widths, leave out those that add too little beside the others; say what stays.

    Half of them go at a time, the worst ones, so that each is judged beside few that are not there.
    """
    members = _members(parameters)
    while widths.any():
        taken = np.flatnonzero(widths)
        beside, local = _beside_others(scaled, members[taken], widths[taken])
        gains, widths[taken] = _element_gains(beside, local, rarity(parameters, TAUS))
        low = gains - np.log(max(parameters.trials, 1)) - 1.0 < RULES.element_nats
        if not low.any():
            break
        widths[taken[np.argsort(gains)[: (int(low.sum()) + 1) // 2]]] = 0.0
    return widths > 0


def _beside_others(scaled: Scaled, members: IntArray, widths: FloatArray) -> tuple[Scaled, IntArray]:
    """Return K and u of each element with all others marginalised, as blocks on the diagonal, and their members there.

    With C the posterior covariance of all and T that of an element's prior these are C_e^-1 - T^-1 and C_e^-1 x_e.
    """
    used = members[members >= 0]
    sizes = np.sum(members >= 0, axis=1)
    stated = np.repeat(widths**-2.0, sizes)
    local = np.full(members.shape, -1)
    local[members >= 0] = np.arange(len(used))
    found, own = np.zeros((len(scaled[0]), len(used), len(used))), np.zeros((len(scaled[0]), len(used)))
    for information, score, beside, left in zip(*scaled, found, own, strict=True):
        # What the data do not constrain are rounding errors, so that no prior is wider than these let it be.
        precision = np.maximum(stated, RANK_RTOL * float(np.max(np.diag(information), initial=0.0)))
        covariance = inverse_hermitian(information[np.ix_(used, used)] + np.diag(precision))
        x = covariance @ score[used]
        for size in np.unique(sizes):  # elements of a size at once
            one = local[sizes == size, :size]
            corner = one[:, :, np.newaxis], one[:, np.newaxis, :]
            inverse = np.linalg.inv(covariance[corner])
            beside[corner] = inverse - precision[one][:, :, np.newaxis] * np.eye(size)
            left[one] = (inverse @ x[one][:, :, np.newaxis])[..., 0]
    return (found, own), local


def each_alone(scaled: Scaled, parameters: Parameters) -> FloatArray:
    """Return by how much the element of each parameter alone raises ln evidence, at the price of picking it."""
    gains, _ = _element_gains(scaled, _members(parameters), rarity(parameters, TAUS))
    return (gains - np.log(max(parameters.trials, 1)) - 1.0)[parameters.element]


def _members(parameters: Parameters) -> IntArray:
    """Return the parameters of each element, (Nelements, p), padded with -1."""
    n_elements = int(parameters.element.max()) + 1
    counts = np.bincount(parameters.element, minlength=n_elements)
    members = np.full((n_elements, int(counts.max())), -1)
    order = np.argsort(parameters.element, kind="stable")
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    members[parameters.element[order], np.arange(len(order)) - np.repeat(starts, counts)] = order
    return members


def _element_gains(working: Scaled, members: IntArray, price: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much each element alone would raise ln BF, and at which prior width, each at its ``price``."""
    return _gains_of(_spectra(working, members), price)


def _best_element(working: Scaled, members: IntArray, price: FloatArray) -> tuple[int, float, float]:
    """Return which element alone would raise ln BF most, by how much, and at which prior width.

    No width gives one more than its likelihood can rise, so that most need not be tried with all of them.
    """
    values, projections = _spectra(working, members)
    most = 0.5 * np.sum(projections**2 / np.where(values > 0, values, 1.0), axis=(0, -1))
    order, best = np.argsort(-most, kind="stable"), (0, -np.inf, float(TAUS[0]))
    for some in np.split(order, np.arange(TRIED_AT_ONCE, len(order), TRIED_AT_ONCE)):
        if most[some[0]] - price.min() < best[1]:
            break
        gains, taus = _gains_of((values[:, some], projections[:, some]), price)
        place = int(gains.argmax())
        if gains[place] > best[1]:
            best = int(some[place]), float(gains[place]), float(taus[place])
    return best


def _gains_of(spectra: Scaled, price: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what `_element_gains` does, from what `_spectra` gives."""
    total = np.tile(-price[:, np.newaxis], spectra[0].shape[1])
    for values, projections in zip(*spectra, strict=True):
        total += log_bayes_factors(values, projections)
    best = total.argmax(axis=0)
    return total[best, np.arange(total.shape[1])], TAUS[best]


def _spectra(working: Scaled, members: IntArray) -> Scaled:
    """Return the eigenvalues of K of each element by itself, zero where they count as that, and u along them.

    Both are (Nblocks, Nelements, p).
    """
    (information, score), present = working, members >= 0
    corner = information[:, members[:, :, np.newaxis], members[:, np.newaxis, :]]
    corner = np.where(present[:, :, np.newaxis] & present[:, np.newaxis, :], corner, 0.0)
    values, vectors = eigen(corner) if members.shape[1] > 1 else (corner[..., 0], np.ones(corner.shape))
    own = np.where(present, score[:, members], 0.0)
    projections = np.einsum("...pi,...p->...i", vectors, own)
    largest = np.maximum(values[..., -1:], 0.0)
    least = 1e-12 * np.maximum(largest.max(axis=1, keepdims=True, initial=0.0), 1e-300)
    told = values > np.maximum(RANK_RTOL * largest, least)
    return np.where(told, values, 0.0), np.where(told, projections, 0.0)


def _condition(working: Scaled, chosen: IntArray, tau: float) -> Scaled:
    """Marginalise some parameters with their prior.

    Directions that the data do not constrain are skipped: their entries are rounding errors of either sign, which would
    outweigh the precision of a wide prior.
    """
    information, score = working
    values, vectors = eigen(information[:, chosen[:, np.newaxis], chosen])
    told = values > RANK_RTOL * np.maximum(values[:, -1:], 0.0)
    across = information[:, :, chosen] @ vectors
    solved = across * np.where(told, 1 / np.where(told, values + 1 / tau**2, 1.0), 0.0)[:, np.newaxis]
    along = np.einsum("bpi,bp->bi", vectors, score[:, chosen])
    return information - solved @ across.transpose(0, 2, 1), score - np.einsum("bqi,bi->bq", solved, along)


def log_bayes_factors(values: FloatArray, projections: FloatArray) -> FloatArray:
    """Return ln BF for every one of `TAUS`, (Ntaus, ...), from eigenvalues of K and u along them, (..., p)."""
    tau2 = TAUS.reshape(-1, *(1,) * values.ndim) ** 2
    # In place, as memory for each step would take longer than the step.
    grown = tau2 * np.maximum(values, 0.0)
    grown += 1
    nats = tau2 * projections**2
    nats /= grown
    nats -= np.log(grown, out=grown)
    return np.asarray(0.5 * nats.sum(axis=-1))
