"""Which effects together explain the residual: a search by marginal likelihood over all of them at once.

An effect that is weighed by itself also gets the evidence of what it can stand for. So effects are chosen with all
others of the set marginalised, each with the prior that is the best then (`find_possible`: elements, functions of time
or all of it, with widths of their own and at their price). Effects are added, weighed again, left out, and exchanged
for others, one or several, until no such move raises the evidence of the whole set: sparse Bayesian learning (Tipping
and Faul 2003) in groups. All effects are linearised where they are not there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from hydrabeam_mpi.loop.attribution.joint_likelihood import JointLikelihood, State, without
from hydrabeam_mpi.loop.rules import RULES

MOST_SWEEPS = 20
"""Moves of each sort at most: far more than there are effects in any data, so that rounding cannot go round."""
LEAST_GAIN = 0.1
"""Nats below which a move gains nothing: widths are tried in steps that cost as much."""


@dataclass(frozen=True)
class JointSet:
    """Effects that explain the residual together.

    Attributes
    ----------
    order : tuple of int
        Their numbers among the competitors, by the evidence that each has beside the others, best first.
    beside : dict of int to dict of int to Evidence
        For each of them, what it and every competitor that is not of the set has beside the others.
    log_bayes_factor : float
        Of all of them together.
    gain : float
        By how much they raise ln likelihood together.
    simpler : tuple of JointSet
        Others that began with another effect, the best first; each has fewer parameters than all before it.
    """

    order: tuple[int, ...] = ()
    beside: Mapping[int, State] = field(default_factory=dict)
    log_bayes_factor: float = 0.0
    gain: float = 0.0
    simpler: tuple[JointSet, ...] = ()


def search(joint: JointLikelihood, least: float) -> JointSet:
    """Find the set of effects with the most evidence, each of which adds ``least`` nats to that of the others.

    It begins with each effect that comes near the best one by itself. One that stands for several is followed by others
    that make up for what it lacks, and no exchange of one of these at a time leads out of that. Those that lead to
    simpler sets are told as well: what strong effects have that is not linear, some thousandths of their evidence, what
    has more parameters takes up. A set ends where a control model is wanted beside its effects: what they leave is
    then none of the others, or is not linear.
    """
    begun = [_begun(joint, first, least) for first in _firsts(joint, least)]
    if not begun:
        return JointSet()
    (state, total), *others = sorted(begun, key=lambda one: -one[1])
    state, total = _moved(joint, state, total, least)
    best = _as_set(joint, state, total, least)
    fewest, known, simpler = _n_parameters(state), {frozenset(best.order)}, list[JointSet]()
    for other, evidence in others:
        if _n_parameters(other) >= fewest:
            continue
        told = _as_set(joint, other, evidence, least)
        if frozenset(told.order) not in known:
            fewest = _n_parameters(other)
            known.add(frozenset(told.order))
            simpler.append(told)
    return replace(best, simpler=tuple(simpler))


def _n_parameters(state: State) -> float:
    return sum(one.effective_parameters for one in state.values())


def _moved(joint: JointLikelihood, state: State, total: float, least: float) -> tuple[State, float]:
    """Exchange and share out the effects of a set until that gains nothing; return it with its ln evidence."""
    for _ in range(MOST_SWEEPS):
        further = _exchanged(joint, state, least) or _shared_out(joint, state, least)
        if further is None:
            break
        further = _settled(joint, further)
        # Settled, a set may have less evidence than when it was put together: beside others, some of it cannot be.
        now = _of_all(joint, further)
        if now <= total + LEAST_GAIN:
            break
        state, total = further, now
    return state, total


def _as_set(joint: JointLikelihood, state: State, total: float, least: float) -> JointSet:
    own = {m: joint.weigh(without(state, m), [m]) for m in state}
    order = [m for m in own if own[m][m].log_bayes_factor >= least]
    order.sort(key=lambda m: -own[m][m].log_bayes_factor)
    free = _free(joint, state)
    beside = {m: own[m] | joint.weigh(without(state, m), free) for m in order}
    return JointSet(tuple(order), beside, total, joint.gain(state))


def _firsts(joint: JointLikelihood, least: float) -> list[State]:
    """Return sets of one: each effect that comes near the best competitor, the best first."""
    found = joint.weigh({}, _free(joint, {}))
    most = max((one.log_bayes_factor for one in found.values()), default=0.0)
    near = [i for i, one in found.items() if one.log_bayes_factor >= max(least, RULES.near_if_linear * most)]
    near = [i for i in near if not joint.competitors[i].is_control]
    return [{i: found[i]} for i in sorted(near, key=lambda i: -found[i].log_bayes_factor)]


def _begun(joint: JointLikelihood, first: State, least: float) -> tuple[State, float]:
    """Return the set that a first effect leads to, with its ln evidence."""
    state = _settled(joint, _added(joint, first, (), least))
    return state, _of_all(joint, state)


def _free(joint: JointLikelihood, state: State, banned: Collection[int] = ()) -> list[int]:
    return [i for i in range(len(joint.competitors)) if i not in state and i not in banned]


def _of_all(joint: JointLikelihood, state: State) -> float:
    """Return ln evidence for a set, by the chain rule."""
    total, so_far = 0.0, State()
    for i, one in state.items():
        so_far = {**so_far, i: one}
        total += joint.worth(so_far, i)
    return total


def _added(joint: JointLikelihood, state: State, banned: Collection[int], least: float) -> State:
    """Add effects one by one, the one with the most evidence beside those of the set first, up to a control model."""
    free = _free(joint, state, banned)
    while True:
        # What has no evidence beside some effects hardly has it beside more.
        best, free = joint.foremost(state, free, least)
        if not best or any(joint.competitors[i].is_control for i in best):
            return state
        state = {**state, **best}


def _settled(joint: JointLikelihood, state: State) -> State:
    """Weigh each of a set again beside the others, with other elements and widths or none, until nothing gains."""
    for _ in range(MOST_SWEEPS):
        before = state
        for i in list(state):
            new = joint.weigh(without(state, i), [i])[i]
            if new.log_bayes_factor < 0:
                state = without(state, i)
            elif new is not state[i] and new.log_bayes_factor > joint.worth(state, i) + LEAST_GAIN:
                state = {**state, i: new}
        if state is before:
            break
    return state


def _exchanged(joint: JointLikelihood, state: State, least: float) -> State | None:
    """Leave out one of a set and let others, one or several, make up for it; return the set if that is better."""
    for i in state:
        rest = without(state, i)
        own = joint.worth(state, i)
        instead = _added(joint, rest, (i,), least)
        # Of those that were added, the evidence that each had when it was.
        if sum(one.log_bayes_factor for j, one in instead.items() if j not in rest) > own + LEAST_GAIN:
            return instead
    return None


def _shared_out(joint: JointLikelihood, state: State, least: float) -> State | None:
    """Let another effect take over a part of what one of a set explains; return the set if that is better.

    Positions of all antennas stand for a wrong clock as well: beside a clock those of one antenna are left.
    """
    for i in state:
        rest = without(state, i)
        own = joint.worth(state, i)
        best, most = None, own + LEAST_GAIN
        for j, other in joint.all_above(least, rest, _free(joint, state)).items():
            if joint.competitors[j].is_control:
                continue
            beside = {**rest, j: other}
            left = joint.all_above(max(least, most - other.log_bayes_factor), beside, [i]).get(i)
            if left is not None and left.log_bayes_factor + other.log_bayes_factor > most:
                best, most = {**beside, i: left}, left.log_bayes_factor + other.log_bayes_factor
        if best is not None:
            return _added(joint, best, (), least)
    return None
