"""The evidence for an effect: Bayes factors of linear Gaussian models, maximised over the width of the prior.

With the beam marginalised the likelihood of an effect's parameters x is exp(u.x - x^T K x / 2) relative to that of no
effect. With the prior x ~ N(0, T), T diagonal, the logarithm of the Bayes factor is

    ln BF = -1/2 ln det(1 + T^1/2 K T^1/2) + 1/2 u^T (K + T^-1)^-1 u.

Two priors are tried. In the *dense* one every parameter has the width tau times its natural scale. In the *sparse* one
only some elements (an antenna, a source) are at fault (`few_elements`), each with a width of its own and at the price
of ln(trials); where elements are nested, those before the last one are then in use as well. Widths maximise the
evidence, which overrates it by about one nat each; that is taken off. An element that is larger than any that is
expected costs as much more as there are fewer of its size, ln 1/N(> tau). Effects that change in time have a third
prior, in which whole sets of parameters are taken so: those of all antennas with one function of time. Where elements
have parameters of several sorts (amplitude and phase, or East, North and Up), some of these may be zero in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Parameters
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.gaussian import Block, Gaussian
from hydrabeam_mpi.inference.likelihood import RANK_RTOL, Likelihood
from hydrabeam_mpi.loop.attribution.few_elements import TAUS, Scaled, each_alone, few_elements, log_bayes_factors
from hydrabeam_mpi.loop.attribution.price import price_of, price_of_sorts, rarity, sets_of, without_sorts


@dataclass(frozen=True)
class Evidence:
    """What the data say of an effect.

    Attributes
    ----------
    log_bayes_factor : float
        Natural logarithm.
    prior_var : ndarray, (q,)
        Prior variance of each parameter; zero for those that are left out.
    x : ndarray, (Nblocks, q)
        Posterior mean of each block: a channel, or all channels where the parameters are shared.
    chi2_drop : float
        By which x lowers chi^2.
    effective_parameters : float
        How many parameters the data determine.
    absorbed : float
        Fraction of the signature of x, in chi^2, that the beam's own freedom takes up.
    rank : int
        Rank of K over all blocks.
    linear_gain : float
        By how much x raises the logarithm of likelihood times prior, as far as the model is linear.
    alone : ndarray, (q,)
        By how much the element of each parameter alone raises ln evidence, where the prior was looked for.
    std : ndarray, (Nblocks, q)
        Posterior standard deviations of x; zero where the prior is.
    n_picked : int
        How many elements were picked of several; one where all are in use.
    """

    log_bayes_factor: float
    prior_var: FloatArray
    x: FloatArray
    chi2_drop: float
    effective_parameters: float
    absorbed: float
    rank: int
    linear_gain: float
    alone: FloatArray = field(default_factory=lambda: np.zeros(0))
    std: FloatArray = field(default_factory=lambda: np.zeros(0))
    n_picked: int = 1

    @property
    def n_parameters(self) -> int:
        """Parameters in use, over all blocks."""
        return int(np.count_nonzero(self.prior_var)) * len(self.x)

    @property
    def price(self) -> float:
        """What the freedom of the parameters costs: what x raises of likelihood times prior, less of evidence."""
        return self.linear_gain - self.log_bayes_factor

    @property
    def least_price(self) -> float:
        """What it costs at least: once it is fitted, an effect may want a single one of the elements picked."""
        return self.price / self.n_picked

    def with_gain(self, gain: float) -> Evidence:
        """Return the evidence of a fit that raises ln(likelihood x prior) by ``gain``, at the same price."""
        return replace(self, log_bayes_factor=gain - self.price, linear_gain=gain)

    def with_others(self, others: Sequence[Evidence]) -> Evidence:
        """Return what it and others come to together, each weighed beside those before it."""
        every = (self, *others)
        return replace(
            self,
            log_bayes_factor=sum(one.log_bayes_factor for one in every),
            effective_parameters=sum(one.effective_parameters for one in every),
            linear_gain=sum(one.linear_gain for one in every),
        )


def find_evidence(
    blocks: Sequence[Likelihood], parameters: Parameters, degenerate_directions: FloatArray | None = None
) -> Evidence:
    """Compute the evidence for an effect with the better of the two priors.

    Parameters
    ----------
    blocks : list of Likelihood
        Independent of each other given the prior, such as channels.
    parameters : Parameters
        Those `nonlinear` have no part.
    degenerate_directions : ndarray, (n, q), optional
        Combinations that no data can tell from another beam. They are marginalised without a prior, so that they add
        nothing to the evidence.
    """
    if degenerate_directions is not None and len(degenerate_directions):
        blocks = [block.freed(degenerate_directions) for block in blocks]
    log_bayes_factor, prior_var, rank = _best_prior(blocks, parameters)
    if parameters.sort is not None:
        log_bayes_factor, prior_var = _of_fewer_sorts(blocks, parameters, log_bayes_factor, prior_var)
    alone = each_alone(_in_natural_sizes(blocks, parameters), parameters)
    return replace(_describe(blocks, parameters, log_bayes_factor, prior_var, rank), alone=alone)


def _best_prior(blocks: Sequence[Likelihood], parameters: Parameters) -> tuple[float, FloatArray, int]:
    """Return ln BF and the variances, (q,), of the prior that has the most evidence, of those above, and K's rank."""
    scale = np.where(parameters.nonlinear, 0.0, parameters.scale)
    scaled = _in_natural_sizes(blocks, parameters)
    spectra = _spectra(*scaled)
    n_elements = len(np.unique(parameters.element))
    dense_log, tau = _dense(spectra, n_elements * rarity(parameters, TAUS))
    best = (dense_log, np.where(scale > 0, (tau * scale) ** 2, 0.0))
    if n_elements > 1 or parameters.trials > 1:
        sparse_log, widths = few_elements(scaled, parameters, tau)
        if parameters.nested and widths.any():
            taken, widths = widths, _filled(widths)
            old, new = ((one[parameters.element] * scale) ** 2 for one in (taken, widths))
            sparse_log += log_evidence(blocks, new) - log_evidence(blocks, old)
        if sparse_log > dense_log or n_elements < parameters.trials:
            best = (sparse_log, (widths[parameters.element] * scale) ** 2)
    if parameters.across is not None:
        sets = sets_of(parameters)
        across_log, widths = few_elements(scaled, sets, tau)
        if across_log > best[0]:
            best = (across_log, (widths[sets.element] * scale) ** 2)
    return *best, int(np.count_nonzero(spectra[0]))


def _of_fewer_sorts(
    blocks: Sequence[Likelihood], parameters: Parameters, log_bayes_factor: float, prior_var: FloatArray
) -> tuple[float, FloatArray]:
    """Leave out sorts of parameters, such as all phases, the one first without which there is most evidence.

    Arguments and what is returned are ln BF and variances, (q,).
    """
    best, price = (log_bayes_factor, prior_var), price_of_sorts(parameters)
    while parameters.sort is not None and len(sorts := np.unique(parameters.sort[prior_var > 0])) > 1:
        left = [log_evidence(blocks, np.where(parameters.sort == one, 0.0, prior_var)) for one in sorts]
        if max(left) <= log_evidence(blocks, prior_var):
            break
        kept = np.flatnonzero(np.arange(len(sorts)) != int(np.argmax(left)))
        parameters = without_sorts(parameters, np.setdiff1d(parameters.sort, sorts[kept]))
        log_bayes_factor, prior_var, _ = _best_prior(blocks, parameters)
        if log_bayes_factor - price > best[0]:
            best = (log_bayes_factor - price, prior_var)
    return best


def _in_natural_sizes(blocks: Sequence[Likelihood], parameters: Parameters) -> Scaled:
    """Return K and u of each block for parameters in units of their natural sizes; zero for what is not weighed."""
    scale = np.where(parameters.nonlinear, 0.0, parameters.scale)
    information, score = np.array([one.information for one in blocks]), np.array([one.score for one in blocks])
    return scale[:, np.newaxis] * information * scale, scale * score


def find_possible(
    blocks: Sequence[Likelihood],
    parameters: Parameters,
    degenerate_directions: FloatArray | None,
    beyond: Callable[[Evidence], BoolArray],
) -> Evidence:
    """Compute the evidence for those elements of an effect that can be; others have no part.

    Arguments are those of `find_evidence`, and ``beyond`` tells which parameters, (q,), are beyond their limits.
    """
    while (found := find_evidence(blocks, parameters, degenerate_directions)).prior_var.any():
        gone = np.unique(parameters.element[beyond(found)])
        if not len(gone):
            break
        parameters = replace(parameters, scale=np.where(np.isin(parameters.element, gone), 0.0, parameters.scale))
    return found


def evidence_of(
    blocks: Sequence[Likelihood],
    parameters: Parameters,
    prior_var: FloatArray,
    degenerate_directions: FloatArray | None = None,
) -> Evidence:
    """Compute the evidence for an effect with a prior found before, (q,), less the price of finding it.

    Other arguments are those of `find_evidence`.
    """
    if degenerate_directions is not None and len(degenerate_directions):
        blocks = [block.freed(degenerate_directions) for block in blocks]
    rank = sum(int(np.linalg.matrix_rank(block.information, hermitian=True)) for block in blocks)
    log_bayes_factor = log_evidence(blocks, prior_var) - price_of(parameters, prior_var)
    return _describe(blocks, parameters, log_bayes_factor, prior_var, rank)


def _n_picked(parameters: Parameters, prior_var: FloatArray) -> int:
    """Return how many elements a prior of variances (q,) picks; one where it picks all that there are, or none."""
    n, n_all = (len(np.unique(one)) for one in (parameters.element[prior_var > 0], parameters.element))
    return max(n, 1) if n < max(n_all, parameters.trials) else 1


def _spectra(information: FloatArray, score: FloatArray) -> Scaled:
    """Return the eigenvalues of each block's K, zero where they count as that, and u along its eigenvectors."""
    values, vectors = eigen(information)
    values = np.where(values > RANK_RTOL * np.maximum(values[:, -1:], 0.0), values, 0.0)
    return values, np.where(values > 0, np.einsum("bqi,bq->bi", vectors, score), 0.0)


def _dense(spectra: Scaled, price: FloatArray) -> tuple[float, float]:
    """Return ln BF and tau for the prior that is the same for all; a width has its ``price``, (Ntaus,)."""
    total = log_bayes_factors(*spectra).sum(axis=1) - price
    best = int(total.argmax())
    return float(total[best]) - 1.0, float(TAUS[best])


def _filled(widths: FloatArray) -> FloatArray:
    """Give elements that were passed over before the last one taken the widths of their neighbours."""
    taken, place = np.flatnonzero(widths), np.arange(len(widths))
    return np.where(place > taken[-1], 0.0, np.exp(np.interp(place, taken, np.log(widths[taken]))))


def solve(blocks: Sequence[Likelihood], prior_var: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return posterior means (Nblocks, q) and covariances, (q, q) each; zero where the prior is."""
    q, used = len(prior_var), np.flatnonzero(prior_var)
    means, covariances = np.zeros((len(blocks), q)), np.zeros((len(blocks), q, q))
    for mean, covariance, block in zip(means, covariances, blocks, strict=True):
        mean[used], covariance[np.ix_(used, used)] = _with_prior(block, prior_var).moments
    return means, list(covariances)


def _with_prior(block: Likelihood, prior_var: FloatArray) -> Gaussian:
    """Return likelihood times prior of the parameters in use, those whose prior has a width."""
    used = np.flatnonzero(prior_var)
    variance = prior_var[used]
    precision = block.information[np.ix_(used, used)] + np.diag(1 / variance)
    log_scale = -0.5 * float(np.sum(np.log(2 * np.pi * variance)))
    return Gaussian((Block("x", len(used)),), precision, block.score[used], log_scale)


def log_evidence(blocks: Sequence[Likelihood], prior_var: FloatArray) -> float:
    """Return ln of the marginal likelihood with a prior that was not chosen by it, over that without the effect.

    ``prior_var`` is (q,).
    """
    return sum(_with_prior(block, prior_var).log_evidence() or 0.0 for block in blocks)


def _describe(
    blocks: Sequence[Likelihood], parameters: Parameters, log_bayes_factor: float, prior_var: FloatArray, rank: int
) -> Evidence:
    """Work out what follows from the chosen prior."""
    x, covariances = solve(blocks, prior_var)
    drop = seen = present = effective = 0.0
    for mean, covariance, block in zip(x, covariances, blocks, strict=True):
        told = float(mean @ block.information @ mean)
        drop += float(2 * block.score @ mean) - told
        seen += told
        present += float(mean @ block.signal @ mean)
        effective += float(np.sum(covariance * block.information))
    absorbed = 1 - seen / present if present > 0 else 0.0
    used = prior_var > 0
    gain = 0.5 * drop - 0.5 * float(np.sum(x[:, used] ** 2 / prior_var[used]))
    std = np.array([np.sqrt(np.maximum(np.diag(covariance), 0.0)) for covariance in covariances])
    absorbed = float(np.clip(absorbed, 0.0, 1.0))
    n_picked = _n_picked(parameters, prior_var)
    return Evidence(log_bayes_factor, prior_var, x, drop, effective, absorbed, rank, gain, std=std, n_picked=n_picked)
