"""The density of all held-out rows together under the posterior predictive: how likely the fitted rows make them.

With A the beam's columns of the held-out rows, C those of the effects, and N the noise, their residuals are

    r = A beta + C gamma + n,

where beam and effects are as uncertain as the fitted rows leave them: gamma ~ N(0, S), and the beam follows it by
R gamma and is uncertain by P beside that. So r is Gaussian, and integrating over both gives its density
p(test | train), the ratio of the evidences of all rows and of the fitted ones (HDBI II, eqs 11-14). An error of the
beam that rows of many times have in common counts once. By a density of each time by itself a model that leaves more of
the beam open would pay for that once a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.fit.blocks import ColumnBlock, add_block
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.grown import added_response, adds_coefficients
from hydrabeam_mpi.fit.known_precision import Key, KnownPrecision
from hydrabeam_mpi.fit.local_parameters import fit_local, untold, with_own
from hydrabeam_mpi.fit.marginal import in_parts
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.fit.whitening import root_by_shared
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.inference.matrices import cholesky_lower, inverse_of_covariance
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import bcast_object, gather_items, together

T = TypeVar("T")


@dataclass(frozen=True)
class Density:
    """Minus the logarithm of the density of a job's channels, up to that of the noise alone, in two parts.

    Attributes
    ----------
    misfit : ndarray, (Nfreqs,)
        r^H (N + M)^-1 r, with M the covariance of the predictions: on average as much as there are complex data.
    log_spread : ndarray, (Nfreqs,)
        ln|1 + N^-1 M|, by the parts of the data: half of that.
    """

    misfit: FloatArray
    log_spread: FloatArray

    @property
    def log(self) -> float:
        """The logarithm for all channels together."""
        return -float(self.misfit.sum() + self.log_spread.sum())


@dataclass(frozen=True)
class _Left:
    """What a channel's rows say of the effects' errors gamma with the beam integrated over.

    ln of the density is -``misfit`` - ``log_spread`` + gamma.score - gamma^T signal gamma / 2.
    """

    misfit: float
    log_spread: float
    signal: FloatArray
    score: FloatArray

    def moved(self, mean: FloatArray) -> _Left:
        """Return the same with gamma counted from a mean, (q,)."""
        pull = self.signal @ mean
        return replace(self, misfit=self.misfit - float(mean @ (self.score - 0.5 * pull)), score=self.score - pull)

    def seen_through(self, follow: FloatArray) -> _Left:
        """Return what they say of others, which gamma follows by a matrix, (q, p)."""
        return replace(self, signal=follow.T @ self.signal @ follow, score=follow.T @ self.score)

    def integrated(self, which: BoolArray) -> _Left:
        """Return the same with some of gamma, each ~ N(0, 1), integrated over; the others are left."""
        rest = ~which
        factor = _factor_of(self.signal[np.ix_(which, which)])
        white = solve_triangular(
            factor, np.column_stack([self.signal[np.ix_(which, rest)], self.score[which]]), lower=True
        )
        across, pull = white[:, :-1], white[:, -1]
        return _Left(
            self.misfit - 0.5 * float(pull @ pull),
            self.log_spread + float(np.log(np.diag(factor)).sum()),
            self.signal[np.ix_(rest, rest)] - across.T @ across,
            self.score[rest] - across.T @ pull,
        )


def _factor_of(signal: FloatArray) -> FloatArray:
    """Return L with L L^T = 1 + ``signal``, (n, n), which is nowhere negative but for rounding."""
    try:
        return np.asarray(np.linalg.cholesky(np.eye(len(signal)) + signal))
    except np.linalg.LinAlgError:
        # 1 + V D V^T, beside a signal so large that adding one to it changes nothing, from its root [1, V sqrt(D)].
        values, vectors = eigen(signal)
        told = np.where(values > len(values) * np.finfo(float).eps * values[-1], values, 0.0)
        root = np.vstack([np.sqrt(told)[:, np.newaxis] * vectors.T, np.eye(len(signal))])
        upper: FloatArray = np.asarray(np.linalg.qr(root, mode="r"))
        return np.asarray(upper.T * np.sign(np.diag(upper)))


def density_of_channels(context: FitContext, fitted: Fitted) -> Density:
    """Return the density as of `predictive_density`, where each channel's beam is known by itself.

    So it is in a result, which does not keep what the errors of several beams have in common. Collective: all ranks of
    the grid.
    """
    whole = with_whole_beams(context, fitted)
    if whole is fitted:
        return predictive_density(context, fitted)
    return context.of_latest("density of channels", fitted, lambda: _density(context, whole))


def predictive_density(context: FitContext, fitted: Fitted) -> Density:
    """Return the density of the held-out rows as a fit predicts them. Collective: all ranks of the grid.

    Parameters of single times or baselines that the fitted rows do not tell are as uncertain as their prior, whose
    width the fitted rows tell. The model is linear in them about where the held-out rows have them.
    """
    return context.of_latest("density of held-out rows", fitted, lambda: _density(context, fitted))


def _density(context: FitContext, fitted: Fitted) -> Density:
    local, unknown = untold(context, fitted.values), np.zeros(0, dtype=bool)
    if local is not None:
        here, unknown = fit_local(context, fitted, local)
        fitted = replace(fitted, values=here.values)
    values = fitted.values
    channels = of_each_channel(context, fitted, _without_beam)
    with together(context.grid.world):
        found = _without_effects(values, unknown, channels) if channels is not None else None
    density: Density = bcast_object(context.grid.world, found)
    return density


def of_each_channel(
    context: FitContext, fitted: Fitted, told: Callable[[NormalEquations, Posterior, BoolArray, Array], T]
) -> list[tuple[T, FloatArray]] | None:
    """Return what is ``told`` of each channel's held-out rows and the covariance of its effects, on rank 0.

    ``told`` gets the products of the columns of beam and effects, the beam, and how that follows the effects; see
    `_without_beam`. None on the other ranks. Collective: all ranks of the grid.
    """
    values, setup, grid = fitted.values, context.setup, context.grid
    inside = [adds_coefficients(setup, one) for one in values.active]
    effects = {name: one for (name, one), is_in in zip(values.blocks.items(), inside, strict=True) if not is_in}
    seen = ~np.repeat(inside, [one.size for one in values.active]).astype(bool)
    follow, found = added_response(setup, values), {}
    for channel, sums in enumerate(_sums(context, fitted, effects)):
        response, covariance = follow, np.zeros((0, 0))
        if values.active:
            response, covariance = follow + fitted.fit.beam_response[channel], fitted.fit.covariances[channel]
        with together(grid.group), grid.roots_alone():
            if grid.is_group_root:
                response = response.astype(sums.own(BEAM).dtype, copy=False)
                of_channel = told(sums, fitted.fit.posteriors[channel], seen, response)
                found[context.channels[channel]] = of_channel, covariance
    by_channel = gather_items(grid.world, found)
    return None if by_channel is None else list(by_channel.values())


def _sums(context: FitContext, fitted: Fitted, effects: Mapping[str, Active]) -> Iterator[NormalEquations]:
    """Yield the products of the columns of the beam and of some effects, of each of the group's channels.

    Summed over the held-out rows. Collective: all ranks of the grid.
    """
    share, at, grid = context.test, fitted.estimate, context.grid
    with together(grid.world):
        rows, added = share.calibrated(at)
    key = Key(rows.inv_noise_var, share.key_of_sky(at.values), (), None)
    known, grams = share.known_when_held_out.find(grid.group, key), []
    model: dict[str, ColumnBlock] = {BEAM: context.beam, **effects}
    blocks = [Block(name, one.size, one.is_complex) for name, one in model.items()]
    for channel in range(len(context.channels)):
        total = NormalEquations(blocks, known=None if known is None else {(BEAM, BEAM): known.grams[channel]})
        with together(grid.group):
            for _, block, _ in share.row_blocks(channel, at, added[channel], rows):
                total.add_data(block.residual, block.weights)
                add_block(total, block, model)
        total.reduce(grid.group)
        yield total
        grams.append(total.own(BEAM))
    if known is None:
        share.known_when_held_out.keep(KnownPrecision(key, grams, None))


def _without_beam(sums: NormalEquations, beam: Posterior, seen: BoolArray, response: Array) -> _Left:
    """Integrate over the beam, which follows the effects by its ``response``, (n_modes, q).

    Of these effects those that are ``seen``, (q,), have columns in the sums; the others are in the response alone.
    """
    kappa, pull = 1.0 if beam.is_complex else 2.0, sums.projection[BEAM]
    factor = cholesky_lower(beam.precision + kappa * sums.own(BEAM))
    white = solve_triangular(factor, kappa * pull, lower=True)
    misfit = sums.data_norm - float(np.vdot(white, white).real) / kappa
    log_spread = 2 / kappa * float(np.log(np.diag(factor).real / np.diag(beam.factor).real).sum())
    across, signal = products_that_follow(sums, seen, response)
    half = in_parts(solve_triangular(factor, across, lower=True))
    signal -= 2 * kappa * half.T @ half
    score = 2 * (in_parts(response).T @ in_parts(pull) - half.T @ in_parts(white))
    score[seen] += sums.likelihood_alone([name for name in sums.blocks if name != BEAM]).score
    return _Left(misfit, log_spread, 0.5 * (signal + signal.T), score)


def products_that_follow(sums: NormalEquations, seen: BoolArray, response: Array) -> tuple[Array, FloatArray]:
    """Return products of the effects' columns, which the beam follows by its ``response``: D = C + A R.

    They are A^H N^-1 D, (n_modes, q), and 2 Re D^H N^-1 D, (q, q); ``seen`` effects have columns C in the sums.
    """
    names = [name for name in sums.blocks if name != BEAM]
    across, signal = np.zeros_like(response), np.zeros((len(seen), len(seen)))
    across[:, seen] = sums.gather([BEAM], names)
    signal[np.ix_(seen, seen)] = sums.likelihood_alone(names).signal
    follow = sums.own(BEAM) @ response
    # Of products with complex numbers the real parts alone count.
    signal += 2 * (in_parts(response).T @ in_parts(follow + 2 * across))
    return across + follow, 0.5 * (signal + signal.T)


def _without_effects(values: Values, unknown: BoolArray, channels: Sequence[tuple[_Left, FloatArray]]) -> Density:
    """Integrate over the effects' errors, those that channels share after all others.

    Given what channels share, their own parameters are independent of those of others. Of ``unknown`` ones, (q,), the
    prior is known.
    """
    shared = values.shared
    parts = []
    for number, (left, covariance) in enumerate(channels):
        if unknown.any():
            precision = values.prior_precision(number)[np.ix_(unknown, unknown)]
            covariance = with_own(covariance, unknown, inverse_of_covariance(precision))
            left = left.moved(_from_prior(values, unknown, number))
        root = root_by_shared(covariance, shared)
        parts.append(left.seen_through(root).integrated(~shared))
    signal, score = (np.sum([getattr(one, name) for one in parts], axis=0) for name in ("signal", "score"))
    common = _Left(0.0, 0.0, signal, score).integrated(np.ones(len(score), dtype=bool))
    misfit = np.array([one.misfit for one in parts]) + common.misfit / len(parts)
    return Density(misfit, np.array([one.log_spread for one in parts]) + common.log_spread / len(parts))


def _from_prior(values: Values, unknown: BoolArray, number: int) -> FloatArray:
    """Return how far the centre of the prior of ``unknown`` parameters is from their values, (q,), else zero."""
    means = np.concatenate([one.prior.of(number).mean for one in values.active])
    return np.where(unknown, means - values.x[number], 0.0)
