"""What is part of the model is weighed again where it has been fitted, given all else that is part of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.fit.blocks import CandidateBlock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.linearised import active_sums
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.candidate_rows import marginal_of
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.others import beside_model
from hydrabeam_mpi.loop.attribution.score_effects import Finding, weigh
from hydrabeam_mpi.mpi import bcast_object, gather_items, together


@dataclass(frozen=True)
class Known:
    """What the fitted rows say of effects where they have been fitted, with the beam marginalised.

    Attributes
    ----------
    active : tuple of Active
        Those of the model, and what is weighed beside them.
    by_channel : list of Likelihood or None
        Of all parameters of all of these, in use or not; on rank 0.
    """

    active: tuple[Active, ...]
    by_channel: list[Likelihood] | None

    @classmethod
    def of(cls, context: FitContext, fitted: Fitted, beside: Finding | None = None) -> Known:
        """Go through the rows once. Collective: all ranks of the grid."""
        active = fitted.values.active
        if beside is None:
            return context.of_latest("effects", fitted, lambda: cls._of(context, fitted, active))
        evidence = beside.evidence
        more = Active.start(beside.effect, context.setup, evidence.prior_var, np.zeros_like(evidence.x))
        return cls._of(context, fitted, (*active, more))

    @classmethod
    def _of(cls, context: FitContext, fitted: Fitted, active: tuple[Active, ...]) -> Known:
        """Go through the rows once. Collective: all ranks of the grid."""
        with together(context.grid.world):
            rows, added = context.train.calibrated(fitted.estimate)
        found = {}
        for channel, number in enumerate(context.channels):
            named = Values(active).blocks.items()
            blocks = {name: CandidateBlock(one.effect, one.x[number]) for name, one in named}
            sums = active_sums(context, context.train, fitted.estimate, channel, rows, added[channel], blocks)
            if context.grid.is_group_root:
                marginal = marginal_of(context, fitted, sums, channel, blocks)
                found[number] = marginal.likelihood(list(blocks))
        by_channel = gather_items(context.grid.world, found)
        return cls(active, None if by_channel is None else list(by_channel.values()))

    def without(self, context: FitContext, place: int) -> Known:
        """Return what would be known without one of the effects, to first order; see `of_one` for places and the like.

        Serial.
        """
        active = (*self.active[:place], *self.active[place + 1 :])
        if self.by_channel is None:
            return Known(active, None)
        every = np.arange(sum(one.x.shape[1] for one in self.active))
        return Known(active, self._around_zero(context, place, np.delete(every, self._columns(place))))

    def of_one(self, context: FitContext, place: int) -> list[Likelihood]:
        """Return what each channel says of one effect, around zero, after those parameters of the others in use.

        Places and the like stay where they have been fitted: without its flux a source is gone wherever it is. On rank
        0.
        """
        others = [self._columns(i)[one.used] for i, one in enumerate(self.active) if i != place]
        return self._around_zero(context, place, np.concatenate([*others, self._columns(place)]))

    def _columns(self, place: int) -> IntArray:
        """Return where an effect's parameters are among those of all."""
        start = sum(one.x.shape[1] for one in self.active[:place])
        return np.arange(start, start + self.active[place].x.shape[1])

    def _around_zero(self, context: FitContext, place: int, which: IntArray) -> list[Likelihood]:
        """Return what each channel says of some of all parameters, with the effect at a place at zero. On rank 0."""
        assert self.by_channel is not None
        one, own, square = self.active[place], self._columns(place), np.ix_(which, which)
        linear, found = ~one.effect.parameters(context.setup).nonlinear, []
        for known, x in zip(self.by_channel, one.x, strict=True):
            score = known.score + known.information[:, own] @ np.where(linear, x, 0.0)
            found.append(Likelihood(known.information[square], score[which], known.signal[square]))
        return found


def reconsider(context: FitContext, fitted: Fitted, number: int = -1) -> Evidence:
    """Weigh one of the active effects again, by default the last, linearised where it has been fitted.

    Collective: all ranks of the grid. What the linear model expects of it is replaced by what the fit has gained, which
    is `log_joint` beyond that of a fit without it; see `Evidence.linear_gain`.
    """
    (found,) = reconsider_each(context, fitted, [number])
    return found


def reconsider_each(
    context: FitContext, fitted: Fitted, numbers: Sequence[int], beside: Finding | None = None
) -> list[Evidence]:
    """Do as `reconsider` with several effects, each given all others. Collective: all ranks of the grid.

    What is weighed ``beside`` them, and is not part of the model, is marginalised as well, with the prior that was
    found for it.
    """
    known, places = Known.of(context, fitted, beside), range(len(fitted.values.active))
    return [_reweigh(context, fitted, known, places[number], None)[0] for number in numbers]


def compare_priors(
    context: FitContext, fitted: Fitted, known: Known, place: int, prior_var: FloatArray
) -> tuple[Evidence, Evidence]:
    """Do as `reconsider` from what is ``known``, with the best prior and with one of variances (n_params,)."""
    best, given = _reweigh(context, fitted, known, place, None, prior_var)
    return best, given


def as_it_is(context: FitContext, fitted: Fitted, known: Known, place: int) -> Evidence:
    """Do as `compare_priors` with the prior that the effect has, alone."""
    return _reweigh(context, fitted, known, place, known.active[place].prior_var(context.setup))[0]


def as_it_may_be(context: FitContext, fitted: Fitted, known: Known, place: int, least: float) -> Evidence | None:
    """Do as `compare_priors` with the best prior alone; None where none can have a ln Bayes factor above ``least``.

    No prior gives more evidence than the likelihood can rise.
    """
    found = _reweigh(context, fitted, known, place, None, least=least)
    return found[0] if found and found[0].log_bayes_factor > least else None


def _reweigh(
    context: FitContext,
    fitted: Fitted,
    known: Known,
    place: int,
    *priors: FloatArray | None,
    least: float | None = None,
) -> list[Evidence]:
    """Weigh an active effect with each of the priors; None is the best one.

    With none of them where no prior can have a ln Bayes factor above ``least``.
    """
    last = known.active[place]
    rest = replace(fitted.values, active=known.active).without(place)
    weighed: list[Evidence] = []
    with together(context.grid.world):
        if known.by_channel is not None:
            likelihoods = known.of_one(context, place)
            left = beside_model(rest, last.effect, likelihoods)
            if least is None or sum(one.most_gain() for one in left) > least:
                weighed = [weigh(context, rest, last.effect, left, likelihoods, prior_var) for prior_var in priors]
    result: list[Evidence] = bcast_object(context.grid.world, weighed)
    return result
