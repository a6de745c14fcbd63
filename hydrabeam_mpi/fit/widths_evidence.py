"""How wide the prior of the beams is, by the evidence (MacKay 1992, Neural Computation 4, 415).

With the data's information H on the coefficients, their pull g at the fitted ones, which are d from the prior's mean,
and the effects as they have been fitted, a prior with the standard deviations sigma_n has the evidence

    ln p(d | sigma) = kappa / 2 [ -ln |W| - |e|^2 + y^H W^-1 y ] + const,    W = 1 + sigma H sigma,    e = d / sigma,

where y = sigma g - e, and kappa is 1 for real coefficients and 2 for complex ones. Counted from the prior's mean all of
chi^2 that the beam explains would be a term of it, and rounding errors would be nats. With z = e + W^-1 y its gradient
in ln sigma_n, and what the data tell of ln sigma if it is right (Fisher's information), are

    kappa [ |z_n|^2 + (W^-1)_nn - 1 ]        and        2 kappa |1 - W^-1|^2_nm.

The widths follow from numbers that all channels share (`PriorWidths`): which fraction of the model's coefficients they
are, each taken as large as those beside it, a part beside that is smooth on the sky, and, where that pays, a factor for
each azimuthal order. By their own amplitudes, coefficients that happen to be near zero would hardly be free: in the
paper's case ln evidence is less by 420, and the largest coefficient is 8.6 of its widths, where it is 4.0 with the
neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import cast

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.beams_given import sum_for_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM
from hydrabeam_mpi.fit.scoring import Told, highest
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.width_numbers import N_SHARED, WidthNumbers
from hydrabeam_mpi.inference.matrices import cholesky_lower
from hydrabeam_mpi.inference.mode_widths import ModeSizes, PriorWidths
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import DiagonalPrior
from hydrabeam_mpi.mpi import bcast_object, together
from hydrabeam_mpi.setup.beams import stated_widths

BEGIN = tuple(product((1e-3, 1e-2, 0.1, 1.0), (1e-4, 1e-2), ((0.03, 0.03), (0.3, 0.3), (0.1, 1.0))))
"""Fractions, amplitudes and decays where the best ones are looked for first. There are several places where the
evidence is larger than near by, in which the one or the other part has most of the width."""


@dataclass(frozen=True)
class WidthsFound:
    """The widths that data want, None for the stated ones, and the log Bayes factor beside these.

    ``gain`` is the rise of ln evidence from the widths of the fit to these.
    """

    widths: PriorWidths | None
    log_bayes_factor: float
    gain: float


class WidthsEvidence:
    """What a fit tells of the widths of the beam's prior, with the effects as they have been fitted.

    It is told as a function of `WidthNumbers`, at their price. All ranks of the grid take part in all that is asked.
    """

    def __init__(self, context: FitContext, fitted: Fitted) -> None:
        self._world, self._least = context.grid.world, context.problem.job.loop.min_log_bayes_factor
        self._stated, self._now = stated_widths(context.problem.job), fitted.values.prior_widths
        self._channels: list[ToldOfBeam] = []
        self._alone: list[ToldOfBeam] = []
        self._told: dict[tuple[bool, PriorWidths], Told] = {}
        self._take(context, fitted)
        azimuthal = [one.sizes.orders[:, 1] for one in self._channels]
        n_orders = max(self._world.allgather(max((1 + int(one.max()) for one in azimuthal), default=0)))
        counts = sum((np.bincount(one, minlength=n_orders) for one in azimuthal), np.zeros(n_orders, dtype=int))
        self._numbers = WidthNumbers(np.sum(self._world.allgather(counts), axis=0))

    def _take(self, context: FitContext, fitted: Fitted) -> None:
        """Take what the fit tells of each channel's beam."""
        normals = sum_for_beams(context, fitted.estimate).normals
        with together(self._world), context.grid.roots_alone():
            if context.grid.is_group_root:
                priors = context.given(fitted.values).priors
                for normal, beam, prior in zip(normals, fitted.fit.posteriors, priors, strict=True):
                    own = (1.0 if beam.is_complex else 2.0) * normal.own(BEAM)
                    self._add(own, beam, cast(DiagonalPrior, prior))

    def _add(self, own: Array, beam: Posterior, prior: DiagonalPrior) -> None:
        """Take a posterior, of which ``own`` is the data's part of the precision."""
        self._channels.append(ToldOfBeam.of(own, beam, prior))
        self._alone.append(self._channels[-1].alone(prior))

    def best(self, wider: bool = False) -> WidthsFound:
        """Return the widths with the most evidence, or the stated ones where theirs is not less by what the job asks.

        With ``wider`` no width may be less than the stated one.
        """
        begin = self._promising(wider) if self._now is None else self._numbers.of(self._now)
        best, at_best = self._ascend(self._channels, begin, wider)
        at_stated, here = self._at_stated(self._channels), self._here(self._channels)
        if at_best - at_stated < self._least:
            return WidthsFound(None, at_best - at_stated, at_stated - here)
        widths = self._numbers.rounded(best, self._stated if wider else None)
        return WidthsFound(widths, at_best - at_stated, at_best - here)

    def promises(self, wider: bool) -> float:
        """Return about what the best widths gain, as if each coefficient were told by itself; it takes no time."""
        return self._ascend(self._alone, self._promising(wider), wider)[1] - self._here(self._alone)

    def _promising(self, wider: bool) -> FloatArray:
        """Return numbers that are best as if each coefficient were told by itself, all azimuthal orders alike."""
        bounds = self._numbers.bounds(self._stated, wider, uneven=False)
        begins = [self._numbers.of(PriorWidths(*one)) for one in BEGIN]
        found = [self._highest(self._alone, begin, bounds) for begin in begins]
        return max(found, key=lambda one: one[1])[0]

    def _at_stated(self, channels: Sequence[ToldOfBeam]) -> float:
        """Return ln evidence with the stated widths, which have no price."""
        return self._added_up(channels, self._stated).value

    def _here(self, channels: Sequence[ToldOfBeam]) -> float:
        """Return ln evidence with the widths of the fit, less the price of these."""
        if self._now is None:
            return self._at_stated(channels)
        numbers = self._numbers.of(self._now)
        return self._weight(channels, numbers).value - self._numbers.price(numbers)

    def _ascend(self, channels: Sequence[ToldOfBeam], begin: FloatArray, wider: bool) -> tuple[FloatArray, float]:
        """Return the numbers of the most evidence less their price, and this; azimuthal orders differ if that pays.

        With orders that differ it starts from ``begin`` or from the best without, whichever has more evidence: once
        they have been found, as those of the fit, that is most of the way.
        """
        even, of_even = self._highest(channels, begin, self._numbers.bounds(self._stated, wider, uneven=False))
        bounds = self._numbers.bounds(self._stated, wider, uneven=True)
        starts = (even, np.clip(begin, *bounds))
        start = max(starts, key=lambda numbers: self._weight(channels, numbers).value)
        uneven, of_uneven = self._highest(channels, start, bounds)
        found = (even, of_even - self._numbers.price(even)), (uneven, of_uneven - self._numbers.price(uneven))
        return max(found, key=lambda one: one[1])

    def _weight(self, channels: Sequence[ToldOfBeam], numbers: FloatArray) -> Told:
        """Return what data and the prior of the numbers tell of these."""
        return self._added_up(channels, self._numbers.widths(numbers)) + self._numbers.told_before(numbers)

    def _added_up(self, channels: Sequence[ToldOfBeam], widths: PriorWidths) -> Told:
        """Return what the data of all channels tell of the numbers of widths; that of the same ones is kept."""
        key = channels is self._alone, widths
        if key not in self._told:
            self._told[key] = self._told_by(channels, widths)
        return self._told[key]

    def _told_by(self, channels: Sequence[ToldOfBeam], widths: PriorWidths) -> Told:
        """Work that out."""
        n = N_SHARED + len(self._numbers.counts)
        told = Told(0.0, np.zeros(n), np.zeros((n, n)))
        with together(self._world):
            for channel in channels:
                told += channel.at(widths, n)
        all_told = self._world.gather(told)
        # All ranks go the same way, whatever their processors make of a sum.
        return cast(Told, bcast_object(self._world, sum(all_told[1:], all_told[0]) if all_told else None))

    def _highest(
        self, channels: Sequence[ToldOfBeam], begin: FloatArray, bounds: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return where ln(evidence x prior) is largest, starting from ``begin``, and its value there."""
        return highest(partial(self._weight, channels), begin, bounds)


@dataclass(frozen=True)
class ToldOfBeam:
    """What the data say of one channel's beam, and the model's sizes.

    Attributes
    ----------
    information : ndarray, (n, n) or (n,)
        H or its diagonal: of the coefficients, and after them of the numbers of variance one by which many coefficients
        go together (`DiagonalPrior.shape`), if there are such.
    pull, away : ndarray, (n,)
        g and d of the same.
    sizes : ModeSizes
        Of the coefficients.
    """

    information: Array
    pull: Array
    away: Array
    sizes: ModeSizes

    @classmethod
    def of(cls, own: Array, beam: Posterior, prior: DiagonalPrior) -> ToldOfBeam:
        """Take the prior out of a posterior, of which ``own`` is the data's part of the precision."""
        assert prior.sizes is not None
        away = beam.mean - prior.mean
        # At the posterior's mean data and prior pull alike.
        pull = prior.precision_times(away)
        if prior.shape is not None:
            across, numbers = own @ prior.shape, prior.shape.conj().T @ pull
            own = np.block([[own, across], [across.conj().T, prior.shape.conj().T @ across]])
            away, pull = np.append(away - prior.shape @ numbers, numbers), np.append(pull, numbers)
        return cls(own, pull, away, prior.sizes)

    def alone(self, prior: DiagonalPrior) -> ToldOfBeam:
        """Return what they would say were each coefficient told by itself, as its mean and variance are."""
        n, precision = len(prior.sigma), self.information.copy()
        precision[np.diag_indices_from(precision)] += self._with_shape(prior.sigma) ** -2.0
        variance = np.diag(Posterior(self.pull, cholesky_lower(precision)).covariance).real[:n]
        told, away = np.maximum(1 / variance - prior.sigma**-2.0, 0.0), self.away[:n]
        return ToldOfBeam(told, away / prior.sigma**2, away, self.sizes)

    def log_evidence(self, sigma: FloatArray) -> float:
        """Return ln evidence of a prior with any standard deviations, (n,), of what has the whole of H."""
        sigma = self._with_shape(sigma)
        away, given = self.away / sigma, self._given(sigma)
        pull = sigma * self.pull - away
        return _log_evidence(away, pull, given.covariance @ pull, _log_det(given))

    def at(self, widths: PriorWidths, n: int) -> Told:
        """Return what is told of the numbers of widths, (n,)."""
        parts = self.sizes.widths(widths)
        sigma = self._with_shape(np.hypot(*parts))
        away = self.away / sigma
        pull = sigma * self.pull - away
        kappa = _kappa(pull)
        slopes = self._slopes(*parts, n)
        if self.information.ndim == 1:
            weights = 1 + sigma**2 * self.information
            moved, left, log_det = pull / weights, 1 / weights, np.sum(np.log(weights))
            expected = (slopes * (1 - left) ** 2) @ slopes.T
        else:
            given = self._given(sigma)
            moved, left = given.covariance @ pull, np.diag(given.covariance).real
            log_det = _log_det(given)
            squares = given.covariance.real**2 + given.covariance.imag**2
            squares[np.diag_indices_from(squares)] = (1 - left) ** 2
            expected = slopes @ squares @ slopes.T
        slope = slopes @ (kappa * (np.abs(away + moved) ** 2 + left - 1))
        return Told(_log_evidence(away, pull, moved, log_det), slope, 2 * kappa * expected)

    def _with_shape(self, sigma: FloatArray) -> FloatArray:
        """Return standard deviations with those of the numbers after the coefficients, which are one."""
        return np.append(sigma, np.ones(len(self.pull) - len(sigma)))

    def _given(self, sigma: FloatArray) -> Posterior:
        """Return W^-1 as the covariance of coefficients in units of ``sigma``, (n,)."""
        matrix = sigma[:, np.newaxis] * self.information * sigma
        matrix[np.diag_indices_from(matrix)] += 1
        return Posterior(np.zeros_like(self.pull), cholesky_lower(matrix))

    def _slopes(self, proportional: FloatArray, smooth: FloatArray, n: int) -> FloatArray:
        """Return the derivatives of ln sigma by each number, (n, len(pull)), for the two parts of sigma."""
        shares = np.square([proportional, smooth]) / (proportional**2 + smooth**2)
        orders = self.sizes.orders.T
        of_orders = np.arange(n - N_SHARED)[:, np.newaxis] == orders[1]
        slopes = np.vstack([shares, -orders * shares[1], of_orders])
        return np.pad(slopes, [(0, 0), (0, len(self.pull) - slopes.shape[1])])


def _kappa(pull: Array) -> float:
    return 2.0 if np.iscomplexobj(pull) else 1.0


def _log_det(given: Posterior) -> float:
    """Return ln|W|."""
    return 2 * float(np.sum(np.log(np.diag(given.factor).real)))


def _log_evidence(away: Array, pull: Array, moved: Array, log_det: float) -> float:
    """Return ln evidence but for a constant, of e, y, W^-1 y and ln|W|."""
    return _kappa(pull) / 2 * (float(np.vdot(pull, moved).real) - float(np.vdot(away, away).real) - log_det)
