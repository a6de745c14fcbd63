"""Which effects together explain the residual: a search by marginal likelihood over all of them at once.

An effect that is weighed by itself also gets the evidence of what it can stand for. So effects are chosen with all
others of the set marginalised, each with the prior that is the best then (`find_possible`: elements, functions of time
or all of it, with widths of their own and at their price). Effects are added, weighed again, left out, and exchanged
for others, one or several, until no such move raises the evidence of the whole set: sparse Bayesian learning (Tipping
and Faul 2003) in groups. All effects are linearised where they are not there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from hydrabeam_mpi.loop.attribution.joint_likelihood import JointLikelihood, State, without
from hydrabeam_mpi.loop.rules import RULES

MOST_SWEEPS = 20
"""Moves of each sort at most: far more than there are effects in any data, so that rounding cannot go round."""
LEAST_GAIN = 0.01
"""Fraction of what an effect must add, in nats, below which a move gains nothing.

Where 5 nats are asked it is half of what a step in width costs. Where less than what is left does not count, nor does
a hundredth of it.
"""


@dataclass(frozen=True)
class JointSet:
    """Effects that explain the residual together.

    Attributes
    ----------
    order : tuple of int
        Their numbers among the competitors, by the evidence that each has beside the others, best first.
    beside : dict of int to dict of int to Evidence
        For each of them, what it has beside the others, and what every other competitor has that comes near it.
    log_bayes_factor : float
        Of all of them together.
    gain : float
        By how much they raise ln likelihood together.
    simpler : tuple of JointSet
        Others: of strong effects alone, and such that began with another effect, the best first; of these each has
        fewer parameters than all before it.
    """

    order: tuple[int, ...] = ()
    beside: Mapping[int, State] = field(default_factory=dict)
    log_bayes_factor: float = 0.0
    gain: float = 0.0
    simpler: tuple[JointSet, ...] = ()


def search(joint: JointLikelihood, least: float, above_noise: float = 0.0) -> JointSet:
    """Find the set of effects with the most evidence, each of which adds ``least`` nats to that of the others.

    It begins with each effect that comes near the best one by itself. One that stands for several is followed by others
    that make up for what it lacks, and no exchange of one of these at a time leads out of that. Strong effects are
    added first, then to their sets those that are so faint that they may be what strong ones have that is not linear.
    Told as well are sets with less evidence and fewer parameters, and the best of strong effects alone: what these have
    that is not linear, what has more parameters takes up. A set ends where a control model is wanted beside its
    effects: what they leave is then none of the others, or is not linear.

    Parameters
    ----------
    joint : JointLikelihood
    least : float
        What each has to add. No set leaves less than all parameters without a prior do, and nothing counts that
        explains less than that.
    above_noise : float
        By how much ln likelihood may rise until no more than noise is left.
    """
    most = joint.most_gain()
    least = max(least, above_noise - most)
    strong = max(least, RULES.not_linear * most)
    begun = [_moved(joint, *one, strong) for one in _begun(joint, _firsts(joint, least), strong)]
    if not begun:
        return JointSet()
    (state, total), *others = sorted(begun, key=lambda one: -one[1])
    sets = [(state, total), *_simpler(state, others)]
    if strong > max(least, above_noise - joint.gain(state)):
        state = _settled(joint, _added(joint, state, (), least), least)
        every = _moved(joint, state, _of_all(joint, state), least)
        # Beside the faint ones, some of the strong ones may be what cannot be.
        if every[1] > total:
            sets.insert(0, every)
    told = [_as_set(joint, *one, least, above_noise) for one in sets]
    known = [set(one.order) for one in told]
    simpler = [one for n, one in enumerate(told) if n and known[n] not in known[:n]]
    return replace(told[0], simpler=tuple(simpler))


def _simpler(best: State, others: Iterable[tuple[State, float]]) -> Iterator[tuple[State, float]]:
    """Return those of other sets, in their order, that have fewer parameters than all before."""
    fewest = _n_parameters(best)
    for state, total in others:
        if _n_parameters(state) < fewest:
            fewest = _n_parameters(state)
            yield state, total


def _n_parameters(state: State) -> float:
    return sum(one.effective_parameters for one in state.values())


def _moved(joint: JointLikelihood, state: State, total: float, least: float) -> tuple[State, float]:
    """Exchange and share out the effects of a set until that gains nothing; return it with its ln evidence."""
    for _ in range(MOST_SWEEPS):
        further = _exchanged(joint, state, least) or _shared_out(joint, state, least)
        if further is None:
            break
        further = _settled(joint, further, least)
        # Settled, a set may have less evidence than when it was put together: beside others, some of it cannot be.
        now = _of_all(joint, further)
        if now <= total + LEAST_GAIN * least:
            break
        state, total = further, now
    return state, total


def _as_set(joint: JointLikelihood, state: State, total: float, least: float, above_noise: float) -> JointSet:
    """Tell a set by its effects that have the ``least`` evidence beside the others, and more than the set leaves."""
    gain, free = joint.gain(state), _free(joint, state)
    own = {m: joint.weigh(without(state, m), [m]) for m in state}
    order = [m for m in own if own[m][m].log_bayes_factor >= max(least, above_noise - gain)]
    order.sort(key=lambda m: -own[m][m].log_bayes_factor)
    near = {m: RULES.near_if_linear * own[m][m].log_bayes_factor for m in order}
    beside = {m: own[m] | joint.all_above(near[m], without(state, m), free) for m in order}
    return JointSet(tuple(order), beside, total, gain)


def _firsts(joint: JointLikelihood, least: float) -> list[State]:
    """Return sets of one: each effect that comes near the best competitor, the best first."""
    found = joint.weigh({}, _free(joint, {}))
    most = max((one.log_bayes_factor for one in found.values()), default=0.0)
    near = [i for i, one in found.items() if one.log_bayes_factor >= max(least, RULES.near_if_linear * most)]
    near = [i for i in near if not joint.competitors[i].is_control]
    return [{i: found[i]} for i in sorted(near, key=lambda i: -found[i].log_bayes_factor)]


def _begun(joint: JointLikelihood, firsts: Iterable[State], least: float) -> list[tuple[State, float]]:
    """Return the sets that some grow to, each with its ln evidence; those that meet go on as one."""
    found, seen = list[tuple[State, float]](), set[frozenset[int]]()
    for first in firsts:
        for state in _growing(joint, first, (), least):
            if frozenset(state) in seen:
                break
            seen.add(frozenset(state))
        else:
            state = _settled(joint, state, least)
            found.append((state, _of_all(joint, state)))
    return found


def _free(joint: JointLikelihood, state: State, banned: Collection[int] = ()) -> list[int]:
    return [i for i in range(len(joint.competitors)) if i not in state and i not in banned]


def _of_all(joint: JointLikelihood, state: State) -> float:
    """Return ln evidence for a set, by the chain rule."""
    total, so_far = 0.0, State()
    for i, one in state.items():
        so_far = {**so_far, i: one}
        total += joint.worth(so_far, i)
    return total


def _growing(joint: JointLikelihood, state: State, banned: Collection[int], least: float) -> Iterator[State]:
    """Add effects one by one, the one with the most evidence beside those of the set first, up to a control model."""
    free = _free(joint, state, banned)
    yield state
    while True:
        # What has no evidence beside some effects hardly has it beside more.
        best, free = joint.foremost(state, free, least)
        if not best or any(joint.competitors[i].is_control for i in best):
            return
        state = {**state, **best}
        yield state


def _added(joint: JointLikelihood, state: State, banned: Collection[int], least: float) -> State:
    """Return what a set grows to."""
    *_, last = _growing(joint, state, banned, least)
    return last


def _settled(joint: JointLikelihood, state: State, least: float) -> State:
    """Weigh each of a set again beside the others, with other elements and widths or none, until nothing gains."""
    for _ in range(MOST_SWEEPS):
        before = state
        for i in list(state):
            new = joint.weigh(without(state, i), [i])[i]
            if new.log_bayes_factor < 0:
                state = without(state, i)
            elif new is not state[i] and new.log_bayes_factor > joint.worth(state, i) + LEAST_GAIN * least:
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
        if sum(one.log_bayes_factor for j, one in instead.items() if j not in rest) > own + LEAST_GAIN * least:
            return instead
    return None


def _shared_out(joint: JointLikelihood, state: State, least: float) -> State | None:
    """Let another effect take over a part of what one of a set explains; return the set if that adds enough.

    Positions of all antennas stand for a wrong clock as well: beside a clock those of one antenna are left.
    """
    for i in state:
        rest = without(state, i)
        own = joint.worth(state, i)
        best, most = None, own + least
        for j, other in joint.all_above(least, rest, _free(joint, state)).items():
            if joint.competitors[j].is_control:
                continue
            beside = {**rest, j: other}
            for left in joint.all_above(max(least, most - other.log_bayes_factor), beside, [i]).values():
                best, most = {**beside, i: left}, left.log_bayes_factor + other.log_bayes_factor
        if best is not None:
            return _added(joint, best, (), least)
    return None
