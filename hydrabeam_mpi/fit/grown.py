"""A beam with the functions that effects of the model add to its basis: one Gaussian of all of its coefficients.

The joint posterior of the beam's coefficients b in the job's basis and the effects' parameters x is

    x ~ N(x_0, C),    b | x ~ N(b_0 + M (x - x_0), P^-1)

with P the precision given the effects and M the beam's response to them. What is written of the beam has the effects
marginalised; parameters that are coefficients of functions beside the basis become coefficients like the others. What
is added to coefficients in the basis is part of the beams before: see `whole_beams`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.blocks import CandidateBlock
from hydrabeam_mpi.fit.equations import BEAM
from hydrabeam_mpi.fit.learned import Learned
from hydrabeam_mpi.fit.state import Active, Fit, Fitted, Values
from hydrabeam_mpi.fit.whitening import root_of
from hydrabeam_mpi.inference.gaussian import Block, Gaussian
from hydrabeam_mpi.inference.matrices import inverse_of_covariance
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import BlockPrior, DiagonalPrior, Prior
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.joined import join
from hydrabeam_mpi.setup.problem import Problem


def growth_of(setup: ObservingSetup, values: Values) -> list[tuple[Active, LinearBasis]]:
    """Return the effects whose parameters are coefficients of the beam, with the functions of those in use."""
    found = [(one, one.effect.beam_functions(setup)) for one in values.active]
    return [(one, join([functions], one.used.tolist())) for one, functions in found if functions is not None]


def is_of_the_beam(setup: ObservingSetup, one: Active | CandidateBlock) -> bool:
    """Whether an effect's parameters are part of the beam that all antennas have."""
    return one.effect.beam_functions(setup) is not None or adds_coefficients(setup, one)


def adds_coefficients(setup: ObservingSetup, one: Active | CandidateBlock) -> bool:
    """Whether an effect adds to the coefficients of the beam in the job's basis."""
    return one.effect.beam_coefficients(setup, one.x) is not None


def added_coefficients(setup: ObservingSetup, values: Values, channel: int) -> Array:
    """Return what effects add to the coefficients of a channel's beam in the job's basis, (n_modes,)."""
    found = (one.effect.beam_coefficients(setup, one.x[channel]) for one in values.active)
    return np.asarray(sum((one for one in found if one is not None), np.zeros(setup.basis.n_modes)))


def added_response(setup: ObservingSetup, values: Values) -> Array:
    """Return W, how these follow the parameters in use, side by side, (n_modes, q)."""
    parts = [np.zeros((0, setup.basis.n_modes))]
    for one in values.active:
        # Few effects have a part in it, and others may have thousands of parameters.
        units = np.eye(one.x.shape[1])[one.used] if adds_coefficients(setup, one) else None
        added = None if units is None else one.effect.beam_coefficients(setup, units)
        parts.append(np.zeros((one.size, setup.basis.n_modes)) if added is None else added)
    return np.concatenate(parts).T


def grown_beam(
    setup: ObservingSetup, values: Values, channel: int, basis: LinearBasis, mean: Array
) -> tuple[LinearBasis, Array]:
    """Return basis and coefficients of a channel's beam with the functions that effects add to ``basis``.

    Parameters
    ----------
    setup : ObservingSetup
    values : Values
    channel : int
        Among the job's.
    basis : LinearBasis
    mean : ndarray, (n_modes,)
        Coefficients in it.
    """
    growth, added = growth_of(setup, values), added_coefficients(setup, values, channel)
    mean = mean + added if added.any() else mean
    if not growth:
        return basis, mean
    coeffs = [one.x[channel, one.used] for one, _ in growth]
    return join([basis, *(more for _, more in growth)]), np.concatenate([mean, *coeffs])


def grown_problem(problem: Problem, setup: ObservingSetup, values: Values, learned: Learned | None = None) -> Problem:
    """Return the problem whose beam has the functions that effects add to its basis, with the priors as they are there.

    Parameters
    ----------
    problem : Problem
        Of all channels or of some.
    setup : ObservingSetup
        Of all channels.
    values : Values
    learned : Learned, optional
        What is known of the first effects beforehand.
    """
    growth, problem = growth_of(setup, values), problem.with_prior_widths(values.prior_widths)
    problem = _with_added_variances(problem, setup, values)
    if not growth:
        return problem

    def known(one: Active, channel: int) -> Prior:
        return learned.prior_of(values.active.index(one), one, channel) if learned else one.prior.of(channel)

    priors = tuple(
        BlockPrior((prior, *(known(one, int(number)) for one, _ in growth)))
        for prior, number in zip(problem.priors, problem.channel_numbers, strict=True)
    )
    return replace(problem, basis=join([problem.basis, *(more for _, more in growth)]), priors=priors)


def _with_added_variances(problem: Problem, setup: ObservingSetup, values: Values) -> Problem:
    """Return the problem with the prior variances of what effects add to coefficients in the basis, as they have it."""
    if not any(adds_coefficients(setup, one) for one in values.active):
        return problem
    squares, priors = np.square(np.abs(added_response(setup, values))), []
    for prior, number in zip(problem.priors, problem.channel_numbers, strict=True):
        variances = np.concatenate([one.prior.of(int(number)).std() ** 2 for one in values.active])
        if isinstance(prior, DiagonalPrior):
            prior = replace(prior, sigma=np.sqrt(prior.sigma**2 + squares @ variances), sizes=None)
        priors.append(prior)
    return replace(problem, priors=tuple(priors))


def beams_alone(fit: Fit) -> tuple[Posterior, ...]:
    """Return the beams' posteriors in the job's basis, all effects marginalised.

    For complex coefficients this is the part of it that a circular Gaussian can have.
    """
    if not fit.covariances:
        return fit.posteriors
    parts = zip(fit.posteriors, fit.beam_response, fit.covariances, strict=True)
    return tuple(wider(posterior, follow @ root_of(covariance)) for posterior, follow, covariance in parts)


def of_the_beam(setup: ObservingSetup, values: Values) -> BoolArray:
    """Return which of the parameters in use, side by side, are coefficients of the beam, (q,)."""
    own = [np.full(len(one.used), one.effect.beam_functions(setup) is not None) for one in values.active]
    return np.concatenate([np.zeros(0, dtype=bool), *own])


def marginal_beams(
    setup: ObservingSetup, fitted: Fitted, channels: Sequence[int], learned: Learned | None = None
) -> tuple[Posterior, ...]:
    """Return the posteriors of the coefficients of `grown_problem`, all other effects marginalised.

    Parameters
    ----------
    setup : ObservingSetup
    fitted : Fitted
    channels : sequence of int
        The rank group's.
    learned : Learned, optional
        What is known of the first effects beforehand.
    """
    values, fit = fitted.values, fitted.fit
    of_beam = of_the_beam(setup, values)
    if not of_beam.any():
        return beams_alone(fit)
    parts = zip(fit.posteriors, fit.beam_response, fit.covariances, channels, strict=True)
    found = []
    for beam, follow, spread, f in parts:
        prior = learned.of_prior(values, f) if learned else (values.prior_precision(f), values.prior_score(f))
        found.append(_joint(beam, follow, spread, values.x[f], prior, of_beam))
    return tuple(found)


def _joint(
    given: Posterior,
    response: Array,
    covariance: FloatArray,
    x: FloatArray,
    prior: tuple[FloatArray, FloatArray],
    of_beam: BoolArray,
) -> Posterior:
    """Return the posterior of one channel's coefficients; ``of_beam``, (q,), says which parameters are of the beam.

    The effects' parameters are at ``x``, (q,), and of their ``prior`` precision and score there are known.
    """
    more, others = np.flatnonzero(of_beam), np.flatnonzero(~of_beam)
    own, across = covariance[np.ix_(more, more)], covariance[np.ix_(others, more)]
    inverse = inverse_of_covariance(own)
    follow = across @ inverse
    left = covariance[np.ix_(others, others)] - follow @ across.T
    beam = wider(given, response[:, others] @ root_of(left)) if len(others) else given
    # The factor of [[P, -P M], [-M^H P, 1/C + M^H P M]], where M has how the others follow these parameters in it.
    half = beam.factor.conj().T @ (response[:, more] + response[:, others] @ follow)
    n = len(beam.mean)
    factor = np.zeros((n + len(more),) * 2, dtype=beam.factor.dtype)
    factor[:n, :n], factor[n:, :n] = beam.factor, -half.conj().T
    factor[n:, n:] = np.linalg.cholesky(inverse)
    mean = np.concatenate([beam.mean, x[more]])
    evidence = given.log_evidence
    if evidence is not None:
        evidence += _log_ratio(prior, more, inverse_of_covariance(covariance)[np.ix_(more, more)])
    return Posterior(mean, factor, evidence)


def wider(posterior: Posterior, spread: Array) -> Posterior:
    """Return the posterior where the beam also moves by ``spread``, (n_modes, k), times unknowns of variance one."""
    precision = posterior.factor @ posterior.factor.conj().T
    across = -precision @ spread
    of_effects = np.eye(spread.shape[1]) - spread.conj().T @ across
    matrix = np.block([[precision, across], [across.conj().T, of_effects]])
    beam, effects = zip((BEAM, "effects"), spread.shape, 2 * [posterior.is_complex], strict=True)
    left = Gaussian((Block(*beam), Block(*effects)), matrix, np.zeros(len(matrix)), None).marginalise(["effects"])
    return replace(posterior, factor=left.solve(overwrite=True).factor)


def _log_ratio(prior: tuple[FloatArray, FloatArray], index: Array, precision: FloatArray) -> float:
    """Return by how much ln evidence changes if some parameters are integrated over, given the other effects.

    That is ln p(x) + ln |2 pi / precision| / 2, the prior's density at the maximum times the volume of the posterior.
    The ``prior`` is known by its precision and its score there, (q, q) and (q,).
    """
    own, score = prior[0][np.ix_(index, index)], prior[1][index]
    log_prior = 0.5 * float(np.linalg.slogdet(own)[1]) - 0.5 * float(score @ np.linalg.solve(own, score))
    return log_prior - 0.5 * float(np.linalg.slogdet(precision)[1])
