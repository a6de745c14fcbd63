"""Which parameters of which effects are weighed together, of which there is room for some hundreds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.attribution.score_effects import Finding, taken
from hydrabeam_mpi.loop.rules import RULES


@dataclass(frozen=True)
class Element:
    """What an effect may be of: an antenna, a source.

    Attributes
    ----------
    number : int
        Of the effect, among those that are weighed.
    gain : float
        By how much the element alone raises ln evidence.
    columns : ndarray of int
        Its parameters among the effect's.
    """

    number: int
    gain: float
    columns: IntArray


def columns_that_matter(
    context: FitContext, fitted: Fitted, findings: Sequence[Finding]
) -> list[tuple[Finding, IntArray]]:
    """Return effects with the parameters to weigh: those in use, and of further elements those that gain alone.

    All effects have the same room, and what one does not need the others share: one of many parameters leaves out no
    other. Of those that do not find room as a whole the elements are weighed that gain most.
    """
    room = RULES.most_columns
    used = [_in_use(context, fitted, one) for one in findings]
    shares = shared_out([len(which) for which, _ in used], room)
    picked, beside = [], list[Element]()
    for number, ((which, further), share) in enumerate(zip(used, shares, strict=True)):
        elements = _elements(context, findings[number], number, np.append(which, further))
        if len(which) > share:
            which = np.concatenate([which[:0], *(one.columns for one in _foremost(elements, share))])
        room -= len(which)
        picked.append([which])
        beside += (Element(number, one.gain, np.setdiff1d(one.columns, which)) for one in elements)
    for one in _foremost(beside, room):
        picked[one.number].append(one.columns)
    chosen = [np.sort(np.concatenate(parts)) for parts in picked]
    return [(one, which) for one, which in zip(findings, chosen, strict=True) if len(which)]


def shared_out(wanted: Sequence[int], room: int) -> list[int]:
    """Return how much of a room each has that wants some of it: all the same, but for what some do not need."""
    shares = [0] * len(wanted)
    for rank, number in enumerate(sorted(range(len(wanted)), key=lambda number: wanted[number])):
        shares[number] = min(wanted[number], room // (len(wanted) - rank))
        room -= shares[number]
    return shares


def has_all_in_use(one: Finding, which: IntArray) -> bool:
    """Whether the parameters ``which`` of an effect have all among them that are in use."""
    return not np.delete(one.evidence.prior_var > 0, which).any()


def _elements(context: FitContext, one: Finding, number: int, columns: IntArray) -> list[Element]:
    """Return the elements of an effect as far as their parameters are some ``columns``."""
    element, alone = one.effect.parameters(context.setup).element[columns], one.evidence.alone
    each = (columns[element == own] for own in np.unique(element))
    return [Element(number, float(alone[own].max()), own) for own in each]


def _foremost(elements: Sequence[Element], room: int) -> list[Element]:
    """Return those elements that gain most by themselves, as far as there is room."""
    found = []
    for one in sorted(elements, key=lambda one: -one.gain):
        if 0 < len(one.columns) <= room:
            room -= len(one.columns)
            found.append(one)
    return found


def _in_use(context: FitContext, fitted: Fitted, one: Finding) -> tuple[IntArray, IntArray]:
    """Return the parameters of an effect that are in use, or cannot be weighed without each other, and those beside."""
    parameters = one.effect.parameters(context.setup)
    can = (parameters.scale > 0) & ~parameters.nonlinear
    can[taken(fitted.values, one.effect)] = False
    # What no data tell of those in use are combinations with others.
    in_use, combined = one.evidence.prior_var > 0, one.effect.degenerate_directions(context.setup) != 0
    with_others = combined[combined[:, in_use].any(axis=1)].any(axis=0)
    used = can & (in_use | with_others)
    return np.flatnonzero(used), np.flatnonzero(can & ~used & (one.evidence.alone > 0))
