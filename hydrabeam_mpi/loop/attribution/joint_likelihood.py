"""What the data say of all competing effects at once, and of some of them beside others.

Effects are linearised where they are not there. What is in the model already and the effects of a set are marginalised
for whatever is weighed beside them, each of the set with the prior that it has.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
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

        The set is empty where none has the ``least``. Only those that may come first are weighed.
        """
        blocks, most = self._most(state, numbers)
        found, best = self._known(state), State()
        for i in sorted(numbers, key=lambda i: -most[i]):
            if most[i] < least:
                break
            if i not in found:
                found[i] = self._possible(i, blocks[i])
                most[i] = found[i].log_bayes_factor
            if most[i] >= least:
                best, least = {i: found[i]}, most[i]
        return best, [i for i in numbers if most[i] > 0 and i not in best]

    def all_above(self, least: float, state: State, numbers: Collection[int]) -> State:
        """Return the evidence for those of some competitors that have the ``least`` beside those of ``state``."""
        blocks, most = self._most(state, numbers)
        found = self._known(state)
        may = [i for i in numbers if most[i] >= least]
        found.update({i: self._possible(i, blocks[i]) for i in may if i not in found})
        return {i: found[i] for i in may if found[i].log_bayes_factor >= least}

    def _most(self, state: State, numbers: Collection[int]) -> tuple[dict[int, list[Likelihood]], dict[int, float]]:
        """Return the likelihood of those not weighed beside a set so far, and what evidence each of all has at most.

        No prior gives more evidence than the likelihood can rise.
        """
        found = self._known(state)
        blocks = self._each_beside(state, [i for i in numbers if i not in found])
        risen = {i: sum(one.most_gain() for one in own) for i, own in blocks.items()}
        return blocks, risen | {i: found[i].log_bayes_factor for i in numbers if i in found}

    def _known(self, state: State) -> State:
        """Return what has been found beside those of ``state``, to which more is added."""
        return self._weighed.setdefault(_of_objects(state), (state, {} if state else dict(self.alone)))[1]

    def _possible(self, number: int, blocks: Sequence[Likelihood]) -> Evidence:
        one = self.competitors[number]
        return find_possible(blocks, one.parameters, one.degenerate, one.beyond)

    def worth(self, state: State, number: int) -> float:
        """Return ln evidence for one of a set beside the others, with the prior that it has."""
        one = self.competitors[number]
        blocks = self._each_beside(without(state, number), [number])[number]
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


def without(state: State, number: int) -> State:
    """Return a set without one of its effects."""
    return {i: one for i, one in state.items() if i != number}


def _part(one: Likelihood, which: np.ndarray) -> Likelihood:
    """Return the likelihood of some of the unknowns, with the others at zero."""

    def some(matrix: FloatArray) -> FloatArray:
        """Take rows and then columns, which is twice as fast as both at once."""
        return matrix.take(which, 0).take(which, 1)

    return replace(one, information=some(one.information), score=one.score[which], signal=some(one.signal))
