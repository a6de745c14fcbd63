"""Chi^2 of held-out rows in blocks of time and of redundant groups, and whether it got better."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import stats

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.beams_given import price_of_left_out
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.predictive_density import predictive_density
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.inference.significance import sigma_of_log_p
from hydrabeam_mpi.mpi import allreduce_sum


@dataclass(frozen=True)
class HeldoutScore:
    """How well held-out data are predicted: their density, and how that is spread over blocks of them.

    Attributes
    ----------
    times, groups : ndarray, (2, N)
        Sums of |z|^2 / 2, see `Whitened`, and numbers for each time and each redundant group.
    misfit, log_spread : float
        Of all of them together; see `Density`.
    left_out : float
        What the rows cost in ln density that changes of the weights leave out: they are predicted no better than that.
    """

    times: FloatArray
    groups: FloatArray
    misfit: float = 0.0
    log_spread: float = 0.0
    left_out: float = 0.0

    def __add__(self, other: HeldoutScore) -> HeldoutScore:
        """Return the score of these rows and of others."""
        return HeldoutScore(
            self.times + other.times,
            self.groups + other.groups,
            self.misfit + other.misfit,
            self.log_spread + other.log_spread,
            self.left_out + other.left_out,
        )

    @property
    def log_density(self) -> float:
        """Logarithm of the predictive density of all, up to a constant of the noise."""
        return -self.misfit - self.log_spread - self.left_out

    @property
    def chi2(self) -> float:
        """Reduced chi^2 of all."""
        total, n = self.times.sum(axis=1)
        return float(total / n) if n else float("nan")

    @property
    def log_density_at_own_level(self) -> float:
        """The same with all variances scaled by the misfit of a datum where that is above one.

        While something else is not modelled yet the scale of the errors is unknown. Merely wider predictions then gain
        nothing, and the density is that of data which are as uncertain as they turn out to be.
        """
        level = max(self.misfit / self.n_data, 1.0) if self.n_data else 1.0
        return -self.n_data * float(np.log(level)) - self.misfit / level - self.log_spread - self.left_out

    @property
    def n_data(self) -> int:
        """Number of complex data."""
        return round(float(self.times[1].sum()))


def heldout_score(context: FitContext, fitted: Fitted) -> HeldoutScore:
    """Tell how well a fit predicts the held-out rows. Collective: all ranks of the grid."""
    whitened = whiten(context, fitted)
    observation, rows = context.setup.observation, context.test.rows
    power = np.where(whitened.used, 0.5 * np.abs(whitened.z) ** 2, 0.0).sum(axis=0)
    count = whitened.used.sum(axis=0).astype(float)
    times = np.zeros((2, observation.Ntimes))
    groups = np.zeros((2, context.setup.redundant.Ngroups))
    for row, of_rows in enumerate((power, count)):
        np.add.at(times[row], rows.tile.times, of_rows.sum(axis=1))
        np.add.at(groups[row], rows.groups[rows.member], of_rows.sum(axis=0))
    allreduce_sum(context.grid.world, times)
    allreduce_sum(context.grid.world, groups)
    left_out = context.over_channels(price_of_left_out(context, context.test, fitted.values, whitened.used))
    density = predictive_density(context, fitted)
    return HeldoutScore(times, groups, float(density.misfit.sum()), float(density.log_spread.sum()), left_out)


def gain_of(before: HeldoutScore, after: HeldoutScore) -> float:
    """Return by how much the ln density of the held-out rows rises; see `HeldoutScore.log_density_at_own_level`."""
    return after.log_density_at_own_level - before.log_density_at_own_level


def gain_error(before: HeldoutScore, after: HeldoutScore) -> float:
    """Return the standard error of `gain_of`, over blocks of times or of groups.

    The greater of the two. Of a kind with but one block nothing is known; infinite where that is so of both.
    """
    gains = [gain for gain in _gains_of_blocks(before, after) if len(gain) > 1]
    return max((float(np.std(gain, ddof=1)) * np.sqrt(len(gain)) for gain in gains), default=np.inf)


def gain_by_chance(before: HeldoutScore, after: HeldoutScore) -> float:
    """Return the standard deviation of `gain_of` where nothing is there that makes predictions better.

    Blocks, of times or of groups, then get better and worse alike, so that those that get worse tell how much both are:
    the root of twice the sum of their squares. The scatter of all is no measure of that, as what is there may be so in
    few blocks, a baseline or a night. The greater of the two; of what is left of a fit that lacks something else blocks
    of one kind are no draws of their own.
    """
    return max(float(np.sqrt(2 * np.sum(np.minimum(gain, 0.0) ** 2))) for gain in _gains_of_blocks(before, after))


def _gains_of_blocks(before: HeldoutScore, after: HeldoutScore) -> list[FloatArray]:
    """Return by how much the ln density of each block rises that is predicted before and after: times, and groups."""
    gains = []
    for one, two in ((before.times, after.times), (before.groups, after.groups)):
        has = (one[1] > 0) & (two[1] > 0)
        gains.append(_cost(one[:, has], before.chi2) - _cost(two[:, has], after.chi2))
    return gains


def _cost(blocks: FloatArray, chi2: float) -> FloatArray:
    """Return minus the ln density of blocks with all variances scaled by ``chi2`` where that is above one."""
    level = max(chi2, 1.0)
    cost: FloatArray = blocks[1] * np.log(level) + blocks[0] / level
    return cost


def fall_significance(before: HeldoutScore, after: HeldoutScore) -> float:
    """Return by how many standard errors chi^2 fell, over blocks of time or of redundant groups: the greater.

    Each block's own fall is one draw of how much the change helps. What is wrong with few baselines shows in few groups
    but at all times, what is wrong at few times in all groups.
    """
    return max(falls_of_blocks(((before.times, after.times), (before.groups, after.groups))), default=0.0)


def falls_of_blocks(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> list[float]:
    """Return by how many standard errors sums over blocks fell, for each kind of which there are four blocks or more.

    Parameters
    ----------
    pairs : iterable of (ndarray, ndarray), (2, N)
        For each kind of blocks, before and after: the sum and the number, or weight, of each.
    """
    scores = []
    for fall in _falls(pairs):
        spread = float(np.std(fall, ddof=1)) * np.sqrt(len(fall))
        scores.append(float(fall.sum()) / spread if spread > 0 else 0.0)
    return scores


def rank_falls_of_blocks(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> list[float]:
    """Return the same from signs and ranks of the blocks' falls (Wilcoxon 1945), where the sum of all falls.

    One block that falls much more than the others widens the standard error of the sum as much as it adds to that, and
    so hides that most of them fall. Of ranks it is one. Zero where the sum does not fall.
    """
    scores = []
    for fall in _falls(pairs):
        p = stats.wilcoxon(fall, alternative="greater").pvalue if fall.sum() > 0 else 0.5
        scores.append(sigma_of_log_p(float(np.log(max(p, np.finfo(float).tiny)))))
    return scores


def _falls(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> Iterator[FloatArray]:
    """Yield the falls of the blocks of each kind of which there are four or more; see `falls_of_blocks`."""
    for one, two in pairs:
        has = (one[1] > 0) & (two[1] > 0)
        if has.sum() >= 4:
            yield one[0, has] - two[0, has] * (one[1, has] / two[1, has])


def gain_significance(before: HeldoutScore, after: HeldoutScore, log_ratio: float) -> float:
    """Return the significance with which held-out data got better.

    Taken from the scatter of the improvement between blocks, which cannot tell much where these are few; or from the
    predictive densities: without the effect a ratio of e^k (``log_ratio`` is k) occurs with a probability of e^-k at
    most, however it was fitted (Markov's inequality).
    """
    by_density = sigma_of_log_p(-log_ratio) if log_ratio > 0 else 0.0
    return max(fall_significance(before, after), by_density)
