"""Parameters that belong to single times or baselines, which the fitted rows do not tell where these are held out.

What the rest of the model says of a held-out row is known up to the beam's errors, which are alike in all rows of a
time. So of the rows of a time these parameters are fitted with weights that know of that: else they would follow what
the beam has wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import Array, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.by_time import columns_by_time, of_baselines
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import STEP_SIGMAS
from hydrabeam_mpi.fit.grown import adds_coefficients
from hydrabeam_mpi.fit.marginal import in_parts
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Active, Estimate, Fitted, Values
from hydrabeam_mpi.fit.whitening import TimeWhitener
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.mpi import allreduce_sum, together

LOCAL_STEPS = 8
"""Newton steps at most, each of which about squares what the one before has left: all else stays as it is. Three are
enough near the end; far from it some fail, and are taken again shorter."""
SHORTER = 0.25
"""Part of a step that is tried after all of it has led to something less likely. Gains are exponentials, so that a step
of their logarithms may be too long by some tens: two or three quarters bring it back."""


Told = tuple[Values, BoolArray, list[FloatArray]]


def untold(context: FitContext, values: Values) -> str | None:
    """Say for which kind of held-out data (times or baselines) active effects have parameters of their own."""
    by_baselines = context.problem.job.holdout.kind == "baselines"
    kinds = {one.effect.local for one in values.active}
    if by_baselines:
        return "baselines" if "baselines" in kinds else None
    return "times" if "times" in kinds else None


def fold_of(context: FitContext, local: str) -> NDArray[np.int64]:
    """Return which half each held-out row belongs to, broadcastable to (Ntimes, Nbls)."""
    if local == "times":
        return (context.test.rows.groups[context.test.rows.member] % 2)[np.newaxis, :]
    return (context.test.rows.tile.times % 2)[:, np.newaxis]


def fit_local(context: FitContext, fitted: Fitted, local: str, without: int | None = None) -> tuple[Fitted, BoolArray]:
    """Fit the parameters that belong to held-out times or baselines, with all else as it is.

    On all held-out rows, or on those that are not of the half ``without``, see `fold_of`: the fit of these begins where
    that of all ends, which is near. Returns the fit and which of the parameters in use these are, (q,). Collective: all
    ranks of the grid.
    """
    # What effects add to the beams is as uncertain as the rest of these.
    whole = with_whole_beams(context, fitted)
    values, told, own = _told(context, whole, local, without)
    inside = [adds_coefficients(context.setup, one) for one in fitted.values.active]
    outside = ~np.repeat(inside, [one.size for one in fitted.values.active])
    free = np.zeros(len(outside), dtype=bool)
    free[outside] = told
    others = iter(values.active)
    pairs_of = zip(fitted.values.active, inside, strict=True)
    active = tuple(one if is_inside else next(others) for one, is_inside in pairs_of)
    pairs = zip(fitted.fit.covariances, context.channels, strict=True)
    covariances = tuple(with_own(covariance, free, own[number]) for covariance, number in pairs)
    fit = replace(fitted.fit, covariances=covariances)
    return replace(fitted, values=replace(fitted.values, active=active), fit=fit), free


def _told(context: FitContext, whole: Fitted, local: str, without: int | None) -> Told:
    """Return what `_most_likely` says of a fit with whole beams. Collective: all ranks of the grid."""
    at = Estimate(whole.values, whole.fit.posteriors)

    def told() -> Told:
        if without is None:
            return _most_likely(context, at, local, np.ones((1, 1), dtype=bool), at.values.x)
        begin = _told(context, whole, local, None)[0].x
        return _most_likely(context, at, local, fold_of(context, local) != without, begin)

    # The same is asked of beams that are known by themselves, and of those that are known given the effects.
    return context.of_latest(f"held-out parameters, without {without}", whole, told)


def with_own(covariance: FloatArray, free: BoolArray, own: FloatArray) -> FloatArray:
    """Return the covariance, (q, q), where those that are ``free`` have one of their own, and none with others."""
    out = np.where(np.outer(~free, ~free), covariance, 0.0)
    out[np.ix_(free, free)] = own
    return np.asarray(out)


@dataclass(frozen=True)
class _LocalSums:
    """What held-out rows say of all parameters in use, for all that is uncertain of the beam, in each channel.

    Attributes
    ----------
    information : ndarray, (Nfreqs, q, q)
    score : ndarray, (Nfreqs, q)
    loss : ndarray, (Nfreqs, q)
        Minus ln(likelihood x prior) of the rows that tell each parameter, and of the others that these rows tell.
    """

    information: FloatArray
    score: FloatArray
    loss: FloatArray


def _most_likely(context: FitContext, at: Estimate, local: str, kept: BoolArray, begin: FloatArray) -> Told:
    """Take Newton steps of these parameters, with the beams as they are, until they move no further.

    They ``begin`` at some parameters, (Nfreqs, q). Those of a time go back, and on by a part of the step, where that
    has made the rows of this time less likely. What the rows do not tell stays as it is in ``at``. Collective: all
    ranks of the grid.

    Returns
    -------
    Values
    ndarray of bool, (q,)
        Which parameters these are.
    list of ndarray
        Their covariance in each channel.
    """
    world, given, steps = context.grid.world, at.values.x, _Steps.of(context, at, local)
    of_kind = np.concatenate([np.full(one.size, one.effect.local == local) for one in at.values.active])
    at = replace(at, values=at.values.at(np.where(of_kind, begin, given)))
    sums = _local_sums(context, at, local, kept, steps)
    free = of_kind & (np.diag(sums.information.sum(axis=0)) > 0)
    # None of the rows feels what they do not tell.
    values = at.values.at(np.where(free, at.values.x, given))
    covariances, step = _newton_step(values, sums, free)
    if not values.x[:, free].any():
        step = _begun(context, values, step, free)
    for _ in range(LOCAL_STEPS):
        x = values.x
        x[:, free] += step
        # Rank 0 says whether to go on, so that rounding cannot let ranks differ.
        # As in any fit; steps square what is left.
        if world.bcast(_moved(step, covariances)) < STEP_SIGMAS:
            return values.at(x), free, covariances
        with np.errstate(over="ignore", invalid="ignore"):
            there = replace(at, values=values.at(x))
            after = _local_sums(context, there, local, kept, steps)
        is_better = world.bcast((after.loss <= sums.loss)[:, free])
        shorter = SHORTER * step
        x[:, free] = np.where(is_better, x[:, free], values.x[:, free])
        sums = _where(is_better, free, after, sums)
        values = values.at(x)
        covariances, step = _newton_step(values, sums, free)
        step = np.where(is_better, step, shorter)
    return values, free, covariances


def _begun(context: FitContext, values: Values, step: FloatArray, free: BoolArray) -> FloatArray:
    """Return where the first step from zero, (Nfreqs, n), leads effects that are not linear, such as logarithms."""
    x = values.x
    x[:, free] = step
    begun = [one.effect.begun(context.setup, one.x)[:, one.used] for one in values.at(x).active]
    return np.concatenate(begun, axis=1)[:, free]


def _where(is_better: BoolArray, free: BoolArray, after: _LocalSums, before: _LocalSums) -> _LocalSums:
    """Return sums of the parameters, (Nfreqs, n) of those that are ``free``, that go on, and of those that go back."""
    goes_on = np.zeros(before.score.shape, dtype=bool)
    goes_on[:, free] = is_better
    return _LocalSums(
        np.where(goes_on[:, :, np.newaxis], after.information, before.information),
        np.where(goes_on, after.score, before.score),
        np.where(goes_on, after.loss, before.loss),
    )


def _moved(step: FloatArray, covariances: list[FloatArray]) -> float:
    """Return by how many standard deviations one of the parameters moves at most."""
    std = np.sqrt([np.diag(one) for one in covariances])
    return float(np.max(np.abs(step) / std, initial=0.0))


def _newton_step(values: Values, sums: _LocalSums, free: BoolArray) -> tuple[list[FloatArray], FloatArray]:
    """Return the covariance of the parameters that are ``free`` in each channel, and by what they move, (Nfreqs, n)."""
    shared, covariances, steps = values.shared, [], []
    for f, (information, score) in enumerate(zip(sums.information, sums.score, strict=True)):
        both = np.where(np.outer(shared, shared), sums.information.sum(axis=0), information)[np.ix_(free, free)]
        pull = np.where(shared, sums.score.sum(axis=0), score)[free] + values.prior_score(f)[free]
        covariances.append(np.asarray(np.linalg.inv(both + values.prior_precision(f)[np.ix_(free, free)]), dtype=float))
        steps.append(covariances[-1] @ pull)
    return covariances, np.array(steps)


@dataclass(frozen=True)
class _Steps:
    """What is the same at all steps, as all but these parameters stays as it is.

    Attributes
    ----------
    share : RankData
    moving : list of int
        Places of the effects that they are of.
    others : (ndarray, ndarray), optional
        C and E of the other effects, where these stay as they are: not where the sky or antennas become others.
    whiteners : dict
        By channel and time, with the weights and the sky for which they are made: no effect need change either.
    """

    share: RankData
    moving: list[int]
    others: tuple[ComplexArray, ComplexArray] | None
    whiteners: dict[tuple[int, int], tuple[FloatArray, bytes, TimeWhitener]] = field(default_factory=dict)

    @classmethod
    def of(cls, context: FitContext, at: Estimate, local: str) -> _Steps:
        """Work it out for parameters of a kind. Collective: all ranks of the grid."""
        share, active = context.test, at.values.active
        moving = [place for place, one in enumerate(active) if one.effect.local == local]
        stay = [one for place, one in enumerate(active) if place not in moving and not one.effect.changes_sky]
        with together(context.grid.world):
            effects = [active[place].effect for place in moving]
            may_stay = not any(one.changes_sky or one.displaces_sky or one.moves_antennas for one in effects)
            return cls(share, moving, share.effects_of(at, stay) if may_stay else None)

    def calibrated(self, at: Estimate) -> tuple[Rows, ComplexArray]:
        """Return the rows and E as `RankData.calibrated` does. Serial."""
        if self.others is None:
            return self.share.calibrated(at)
        factor, added = self.share.effects_of(at, [at.values.active[place] for place in self.moving])
        return self.share.calibrated(at, (self.others[0] * factor, self.others[1] + added))

    def whitener(self, channel: int, t: int, at: Estimate, weights: FloatArray, design: Array) -> TimeWhitener:
        """Return what whitens the rows of the rank's time number ``t``, (Nbls,); see `RankData.model_root`."""
        sky, known = self.share.key_of_sky(at.values), self.whiteners.get((channel, t))
        if known is not None and known[1] == sky and np.array_equal(known[0], weights):
            return known[2]
        by_beam = self.share.model_root(channel, t, at, design)
        made = TimeWhitener.of(weights, self.share.rows.member, by_beam)
        if self.share.room.designs:
            self.whiteners[channel, t] = weights, sky, made
        return made


def _local_sums(context: FitContext, at: Estimate, local: str, kept: BoolArray, steps: _Steps) -> _LocalSums:
    """Sum over the held-out rows ``kept``. Collective: all ranks of the grid."""
    share, world, values = context.test, context.grid.world, at.values
    with together(world):
        rows, added = steps.calibrated(at)
    rows = replace(rows, inv_noise_var=rows.inv_noise_var * kept)
    n_freqs, q = values.x.shape
    signals, scores = np.zeros((n_freqs, q, q)), np.zeros((n_freqs, q))
    # Parameters of baselines are told by all times together.
    by_time, n_times = local == "times", context.setup.observation.Ntimes
    misfit, of_time = np.zeros((n_freqs, n_times if by_time else 1)), np.zeros(q, dtype=int)
    # A row that is multiplied by nothing has no weight once that is taken out; it is not explained all the same.
    lost = np.where(rows.inv_noise_var > 0, 0.0, kept * share.rows.inv_noise_var * np.abs(share.rows.data) ** 2)
    chosen = [(one, span) for one, span in zip(values.active, values.spans, strict=True) if one.effect.local == local]
    for channel, number in enumerate(context.channels):
        with together(context.grid.group):
            for span, block, design in share.row_blocks(channel, at, added[channel], rows):
                for t, (which, columns) in enumerate(_columns(block, chosen, number)):
                    time = steps.whitener(channel, span.start + t, at, block.weights[t], design[t])
                    white = in_parts(time.rows(np.column_stack([columns, block.residual[t]])))
                    signals[number][np.ix_(which, which)] += white[:, :-1].T @ white[:, :-1]
                    scores[number][which] += white[:, :-1].T @ white[:, -1]
                    place = int(block.times[t]) if by_time else 0
                    # What the model is uncertain of grows with the gains: its share is part of the density.
                    misfit[number, place] += 0.5 * np.sum(white[:, -1] ** 2) - np.sum(np.log(time.scales))
                    misfit[number, place] += lost[channel, span.start + t].sum()
                    of_time[which] = place
    for sums in (signals, scores, misfit):
        allreduce_sum(world, sums)
    of_time = np.max(world.allgather(of_time), axis=0)
    for f in range(n_freqs):
        np.add.at(misfit[f], of_time, _price(values, f))
    misfit = misfit[:, of_time]
    return _LocalSums(signals, scores, np.where(values.shared, misfit.sum(axis=0), misfit))


def _price(values: Values, channel: int) -> FloatArray:
    """Return what each parameter costs in ln of the prior, (q,); of those that hang together its part of theirs."""
    mean = np.concatenate([np.zeros(0), *(one.prior.of(channel).mean for one in values.active)])
    return np.asarray(-0.5 * (values.x[channel] - mean) * values.prior_score(channel))


def _columns(
    block: RowBlock, chosen: list[tuple[Active, slice]], channel: int
) -> Iterator[tuple[IntArray, NDArray[np.complex128]]]:
    """Yield for each time which of all parameters in use its rows tell of effects, and their columns, (Nbls, k)."""
    numbers = np.concatenate([np.arange(span.start, span.stop) for _, span in chosen])
    for parts in columns_by_time(block, [one for one, _ in chosen], channel):
        columns = of_baselines(parts, block.member).tocsc()
        told = np.flatnonzero(np.diff(columns.indptr))
        yield numbers[told], columns[:, told].toarray()
