"""Which effects together explain the residual: a search by marginal likelihood over all of them at once.

An effect that is weighed by itself also gets the evidence of what it can stand for. So effects are chosen with all
others of the set marginalised, each with the prior that is the best then (`find_possible`: elements, functions of time
or all of it, with widths of their own and at their price). Effects are added, weighed again, left out, and exchanged
for others, one or several, until no such move raises the evidence of the whole set: sparse Bayesian learning (Tipping
and Faul 2003) in groups. All effects are linearised where they are not there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.parameters import Parameters
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.all_channels import AllChannels
from hydrabeam_mpi.loop.attribution.evidence import Evidence, evidence_of, find_possible
from hydrabeam_mpi.loop.attribution.others import Others
from hydrabeam_mpi.loop.rules import RULES

MOST_SWEEPS = 20
"""Moves of each sort at most: far more than there are effects in any data, so that rounding cannot go round."""
LEAST_GAIN = 0.1
"""Nats below which a move gains nothing: widths are tried in steps that cost as much."""

State = dict[int, Evidence]
"""A set of effects by number: the evidence that each had beside the others when it was last weighed, with its prior."""

Key = frozenset[tuple[int, int]]


def _of_objects(state: State) -> Key:
    """Tell a set by its objects, to which moves come back, and which stay alive as long as what was found of it."""
    return frozenset((i, id(one)) for i, one in state.items())


def _nothing(found: Evidence) -> BoolArray:
    return np.zeros(found.prior_var.shape, dtype=bool)


@dataclass(frozen=True)
class Competitor:
    """An effect of which some parameters, (q,), are weighed beside those of others.

    Attributes
    ----------
    parameters : Parameters
        These alone.
    degenerate : ndarray, (n, q)
        Combinations that no data can tell from another beam.
    shared : bool
        Whether channels share them.
    is_control : bool
    beyond : function of Evidence
        Which of them, (q,), are beyond what is physical.
    """

    parameters: Parameters
    degenerate: FloatArray
    shared: bool
    is_control: bool = False
    beyond: Callable[[Evidence], BoolArray] = _nothing


@dataclass(frozen=True)
class JointLikelihood:
    """What the data say of the parameters of all competitors, with the beam marginalised.

    Attributes
    ----------
    by_channel : list of Likelihood
        Of what is in the model already, then of each competitor's parameters, in their order.
    model : Others
        What is in the model already.
    competitors : list of Competitor
    alone : dict of int to Evidence
        For those competitors of which it is known with nothing else beside them.
    """

    by_channel: Sequence[Likelihood]
    model: Others
    competitors: Sequence[Competitor]
    alone: State = field(default_factory=dict)
    _weighed: dict[Key, tuple[State, State]] = field(default_factory=dict)
    _latest: list[tuple[tuple[Key, tuple[int, ...]], State, dict[int, list[Likelihood]]]] = field(default_factory=list)

    def weigh(self, state: State, numbers: Collection[int]) -> State:
        """Return the evidence for some competitors beside those of ``state``, each alone, with its best prior."""
        found = self._known(state)
        for i, blocks in self._each_beside(state, [i for i in numbers if i not in found]).items():
            found[i] = self._possible(i, blocks)
        return {i: found[i] for i in numbers}

    def foremost(self, state: State, numbers: Collection[int], least: float) -> tuple[State, list[int]]:
        """Return which has the most evidence beside those of ``state``, as a set of it alone, and which others may.

        The set is empty where none has the ``least``. No prior gives more evidence than the likelihood can rise, so
        that only those that may come first are weighed.
        """
        found = self._known(state)
        blocks = self._each_beside(state, [i for i in numbers if i not in found])
        most = {i: sum(one.most_gain() for one in own) for i, own in blocks.items()}
        most |= {i: found[i].log_bayes_factor for i in numbers if i in found}
        best: State = {}
        for i in sorted(numbers, key=lambda i: -most[i]):
            if most[i] < least:
                break
            if i not in found:
                found[i] = self._possible(i, blocks[i])
                most[i] = found[i].log_bayes_factor
            if most[i] >= least:
                best, least = {i: found[i]}, most[i]
        return best, [i for i in numbers if most[i] > 0 and i not in best]

    def _known(self, state: State) -> State:
        """Return what has been found beside those of ``state``, to which more is added."""
        return self._weighed.setdefault(_of_objects(state), (state, {} if state else dict(self.alone)))[1]

    def _possible(self, number: int, blocks: Sequence[Likelihood]) -> Evidence:
        one = self.competitors[number]
        return find_possible(blocks, one.parameters, one.degenerate, one.beyond)

    def worth(self, state: State, number: int) -> float:
        """Return ln evidence for one of a set beside the others, with the prior that it has."""
        one = self.competitors[number]
        blocks = self._each_beside(_without(state, number), [number])[number]
        return evidence_of(blocks, one.parameters, state[number].prior_var, one.degenerate).log_bayes_factor

    def gain(self, state: State) -> float:
        """Return by how much all of a set together raise ln likelihood."""
        others, order = self._others(self.model, state)
        blocks = [_part(one, order) for one in self.by_channel]
        each = zip(others.best(blocks), blocks, strict=True)
        return float(sum(one.score @ x - 0.5 * x @ one.information @ x for x, one in each))

    def most_gain(self) -> float:
        """Return by how much no set raises ln likelihood more: what all parameters do without a prior."""
        return sum(one.most_gain() for one in self.by_channel)

    def _each_beside(self, state: State, numbers: Collection[int]) -> dict[int, list[Likelihood]]:
        """Return the likelihood of each of some competitors, with those of a set marginalised.

        One that is weighed again with the prior that it has has just been weighed, so that the last is kept.
        """
        key = _of_objects(state), tuple(numbers)
        if self._latest and self._latest[0][0] == key:
            return self._latest[0][2]
        found = dict[int, list[Likelihood]]()
        for shared in (False, True):
            of_sort = [i for i in numbers if self.competitors[i].shared is shared]
            found |= zip(of_sort, self._beside(state, of_sort, shared), strict=True)
        self._latest[:] = [(key, state, found)]
        return found

    def _beside(self, state: State, numbers: Sequence[int], shared: bool) -> list[list[Likelihood]]:
        """Return the same of those whose parameters channels share, or of those of which each has its own."""
        if not numbers:
            return []
        own = [self._columns(i) for i in numbers]
        ends = np.cumsum([0, *map(len, own)])
        if shared and len(self.by_channel) > 1:
            left = [self._all_channels.beside(*self._of_state(state), np.concatenate(own))]
        else:
            model, by_channel = self._beside_model[shared]
            others, order = self._others(model, state)
            every = np.concatenate([order, *(len(model.shared) + one for one in own)])
            left = others.marginalised([_part(one, every) for one in by_channel], shared)
        return [[_part(one, np.arange(*pair)) for one in left] for pair in pairwise(ends)]

    @cached_property
    def _all_channels(self) -> AllChannels:
        """What several channels together say of what they share."""
        return AllChannels.of(*self._beside_model[True])

    @cached_property
    def _beside_model(self) -> dict[bool, tuple[Others, list[Likelihood]]]:
        """What of the model has to be marginalised with a set, and each channel's likelihood without all else of it.

        For what channels share, and for what each has for itself: the model is the same beside every set.
        """
        return {shared: self.model.taken_out(self.by_channel, shared) for shared in (False, True)}

    def _others(self, model: Others, state: State) -> tuple[Others, np.ndarray]:
        """Return what is there of the model and a set, and where that is in a matrix that begins with this model."""
        columns, shared, prior_var = self._of_state(state)
        n = len(model.shared)
        return model.and_more(shared, prior_var), np.concatenate([np.arange(n), n + columns])

    def _of_state(self, state: State) -> tuple[IntArray, BoolArray, FloatArray]:
        """Return the columns that a set has in use, which of them channels share, and their prior variances."""
        used = {i: np.flatnonzero(one.prior_var) for i, one in state.items()}
        none = np.zeros(0)
        columns = [self._columns(i)[own] for i, own in used.items()]
        shared = [np.full(len(own), self.competitors[i].shared) for i, own in used.items()]
        prior_var = [state[i].prior_var[own] for i, own in used.items()]
        return (
            np.concatenate([none.astype(int), *columns]),
            np.concatenate([none.astype(bool), *shared]),
            np.concatenate([none, *prior_var]),
        )

    def _columns(self, number: int) -> IntArray:
        """Return where a competitor's parameters are among those of all."""
        start = sum(len(one.parameters) for one in self.competitors[:number])
        return np.arange(start, start + len(self.competitors[number].parameters))


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
    free = _free(joint, state)
    beside = {m: joint.weigh(_without(state, m), [m, *free]) for m in state}
    order = [m for m in state if beside[m][m].log_bayes_factor >= least]
    order.sort(key=lambda m: -beside[m][m].log_bayes_factor)
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
            new = joint.weigh(_without(state, i), [i])[i]
            if new.log_bayes_factor < 0:
                state = _without(state, i)
            elif new is not state[i] and new.log_bayes_factor > joint.worth(state, i) + LEAST_GAIN:
                state = {**state, i: new}
        if state is before:
            break
    return state


def _exchanged(joint: JointLikelihood, state: State, least: float) -> State | None:
    """Leave out one of a set and let others, one or several, make up for it; return the set if that is better."""
    for i in state:
        rest = _without(state, i)
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
        rest = _without(state, i)
        own = joint.worth(state, i)
        best, most = None, own + LEAST_GAIN
        for j, other in joint.weigh(rest, _free(joint, state)).items():
            if other.log_bayes_factor < least or joint.competitors[j].is_control:
                continue
            beside = {**rest, j: other}
            left = joint.weigh(beside, [i])[i]
            if left.log_bayes_factor >= least and left.log_bayes_factor + other.log_bayes_factor > most:
                best, most = {**beside, i: left}, left.log_bayes_factor + other.log_bayes_factor
        if best is not None:
            return _added(joint, best, (), least)
    return None


def _without(state: State, number: int) -> State:
    return {i: one for i, one in state.items() if i != number}


def _part(one: Likelihood, which: np.ndarray) -> Likelihood:
    """Return the likelihood of some of the unknowns, with the others at zero."""

    def some(matrix: FloatArray) -> FloatArray:
        """Take rows and then columns, which is twice as fast as both at once."""
        return matrix.take(which, 0).take(which, 1)

    return replace(one, information=some(one.information), score=one.score[which], signal=some(one.signal))
