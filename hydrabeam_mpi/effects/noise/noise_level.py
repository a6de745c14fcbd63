"""The noise differs from what the weights state: sigma_jk -> s sqrt(s_j s_k) sigma_jk, overall and by antenna.

With Q the sum of |z|^2 over the rows of a baseline and n the number of rows,

    ln L = -sum (n eta + Q exp(-eta)),    eta_jk = 2 ln s + ln s_j + ln s_k,

which is concave, so that Newton's method finds the maximum and Laplace's the evidence. Whatever the model lacks makes
residuals larger too; what tells noise is that it is white, and residuals that are not are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import Reweighting, ReweightingFit, fitted_counts, with_more_noise
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.whiteness import Structure, structure_of, whiteness_sums
from hydrabeam_mpi.errors import InputError

# Candidate widths of the prior on ln(scale); the evidence chooses among them.
WIDTHS: FloatArray = np.geomspace(0.003, 3.0, 13)
# Width of that of single antennas' scales.
WIDTH_OF_FEW = 1.0
# Width that holds a logarithm at zero.
HELD = 1e-6
# By how much the log evidence must rise before antennas get scales of their own.
MIN_GAIN = 5.0
# By how much it must rise for one more antenna.
MIN_MORE = 3.0


@dataclass(frozen=True)
class _Solution:
    """Maximum of one channel's posterior of (ln s, ln s_j ...): parameters, covariance, log Bayes factor, 2 ln L."""

    x: FloatArray
    covariance: FloatArray
    log_bayes_factor: float
    chi2_drop: float


class NoiseLevel(Reweighting):
    """Scales of the noise: one for all data, and one for each of some or all antennas if the evidence supports that.

    The parameters of a channel are s, or s followed by s_j of all antennas in use. Where few antennas differ from all
    others, these have s_j = 1 and s is theirs; else the mean of ln s_j is zero.
    """

    kind = "noise_level"
    title = "noise level"
    times_refitted = 2

    def scales_antennas(self, x: FloatArray) -> bool:
        """Whether there are more parameters than the one of all data in ``x``, (Nfreqs, n_params)."""
        return x.shape[1] > 1

    def is_told(self, x: FloatArray) -> BoolArray:
        """Return which of some channels' parameters are to be told of: those of all, and of antennas unlike most."""
        told = np.any(x != 1, axis=0)
        told[0] = True
        return np.asarray(told)

    def sizes(self, setup: ObservingSetup) -> tuple[int, ...]:
        """Return one, or one more than there are antennas in use."""
        return 1, 1 + len(setup.antennas_in_use)

    def neutral(self, setup: ObservingSetup) -> dict[str, float]:
        """Return ones."""
        antennas = setup.observation.antenna_numbers[setup.antennas_in_use]
        return dict.fromkeys(("noise scale", *(f"antenna {number} noise scale" for number in antennas)), 1.0)

    def n_sums(self, setup: ObservingSetup) -> int:
        """Return 5 Nbls + 2 Ntimes + 2; see `whiteness_sums`."""
        return 5 * setup.observation.Nbls + 2 * setup.observation.Ntimes + 2

    def sums(self, block: RowBlock, z: ComplexArray) -> FloatArray:
        """Return numbers of rows and powers by baseline and by time, and what tells whether they are white.

        The result is (n_sums,).
        """
        return whiteness_sums(block, z)

    def fit(self, setup: ObservingSetup, sums: FloatArray, effective_parameters: FloatArray) -> ReweightingFit:
        """Weigh one scale, then a scale of each antenna, with ``sums`` (Nfreqs, n_sums); see `Reweighting.fit`."""
        n_bls = setup.observation.Nbls
        power = sums[:, n_bls : 2 * n_bls]
        expected = np.array([fitted_counts(*pair) for pair in zip(sums[:, :n_bls], effective_parameters, strict=True)])
        single, width = _best(setup, expected, power, None)
        all_antennas, _ = _best(setup, expected, power, width)
        few, choice = _few_antennas(setup, expected, power, width)
        by_antenna = (_evidence(few) - choice, few), (_evidence(all_antennas), all_antennas)
        evidence, solutions = max(by_antenna, key=lambda one: one[0])
        if evidence - _evidence(single) <= MIN_GAIN:
            evidence, solutions = _evidence(single), single
        scales = np.exp([one.x for one in solutions])
        std = scales * np.sqrt([np.diag(one.covariance) for one in solutions])
        reason = self._reason(setup, sums, expected, scales)
        names = tuple(self.neutral(setup))[: scales.shape[1]]
        return ReweightingFit(
            log_bayes_factor=min(evidence, 0.0) if reason else evidence,
            x=scales,
            std=std,
            names=names,
            units=("",) * len(names),
            chi2_drop=float(sum(one.chi2_drop for one in solutions)),
            n_parameters=scales.size,
            reason=reason,
        )

    def _reason(self, setup: ObservingSetup, sums: FloatArray, expected: FloatArray, scales: FloatArray) -> str | None:
        """Say why residuals are not noise, for the channel where that is clearest; None where they may be."""
        worst: Structure | None = None
        for channel, x in enumerate(scales):
            variance = _variance(setup, x)
            found = structure_of(setup, sums[channel], expected[channel], variance)
            if found and (worst is None or found.share > worst.share):
                worst = found
        return None if worst is None else f"the residuals {worst.what}, as noise does not"

    def weight_factor(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return 1 / (s^2 s_j s_k), (Ntimes, Nbls)."""
        return np.broadcast_to(1 / _variance(block.setup, x)[block.bls], block.shape)

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw one scale, larger than one by ``strength`` rms, (n_params,)."""
        return np.array([1 + strength * abs(rng.standard_normal())])

    def inject(self, data: ComplexArray, block: RowBlock, x: FloatArray, rng: np.random.Generator) -> ComplexArray:
        """Add noise of variance (s^2 s_j s_k - 1) sigma^2, (Ntimes, Nbls).

        Raises
        ------
        InputError
            If that is negative: noise cannot be taken away.
        """
        more = _variance(block.setup, x)[block.bls] - 1
        if np.any(more < -1e-12):
            raise InputError("noise cannot be taken away", field=self.kind, remedy="give scales of 1 or more")
        return with_more_noise(data, block, more, rng)


def _variance(setup: ObservingSetup, x: FloatArray) -> FloatArray:
    """Return s^2 s_j s_k of every baseline, (Nbls,)."""
    if len(x) == 1:
        return np.full(setup.observation.Nbls, x[0] ** 2)
    first, second = np.searchsorted(setup.antennas_in_use, setup.antenna_index).T
    return np.asarray(x[0] ** 2 * x[1:][first] * x[1:][second])


def _design(setup: ObservingSetup, antennas: bool) -> csr_array:
    """Return the matrix from (ln s, ln s_j ...) to eta, (Nbls, 1) or (Nbls, 1 + Nants)."""
    n_bls, n_ants = setup.observation.Nbls, len(setup.antennas_in_use)
    if not antennas:
        return csr_array(np.full((n_bls, 1), 2.0))
    ends = 1 + np.searchsorted(setup.antennas_in_use, setup.antenna_index)
    index = np.concatenate([np.zeros((n_bls, 1), dtype=int), ends], axis=1)
    values = np.tile([2.0, 1.0, 1.0], n_bls)
    return csr_array((values, index.reshape(-1), np.arange(0, 3 * n_bls + 1, 3)), (n_bls, 1 + n_ants))


def _best(
    setup: ObservingSetup, expected: FloatArray, power: FloatArray, width: float | None
) -> tuple[list[_Solution], float]:
    """Return every channel's solution at the prior width that all channels together prefer, and that width.

    Of the one scale where ``width`` is None; of the scales of antennas otherwise, that of the one scale being given.
    """
    design = _design(setup, antennas=width is not None)
    best: tuple[float, list[_Solution], float] | None = None
    for trial in WIDTHS.tolist():
        prior = np.full(design.shape[1], trial)
        prior[0] = trial if width is None else width
        solutions = [_solve(design, *pair, prior) for pair in zip(expected, power, strict=True)]
        evidence = _evidence(solutions)
        if best is None or evidence > best[0]:
            best = evidence, solutions, trial
    assert best is not None
    return best[1], best[2]


def _few_antennas(
    setup: ObservingSetup, expected: FloatArray, power: FloatArray, width: float
) -> tuple[list[_Solution], float]:
    """Return the solutions with scales of those antennas that want one, taken one by one, and what the choice costs.

    One antenna at least; the cost is the logarithm of how many such choices there are.
    """
    design = _design(setup, antennas=True)
    n_ants = design.shape[1] - 1
    prior = np.full(1 + n_ants, HELD)
    prior[0] = width
    solutions = [_solve(design, *pair, prior) for pair in zip(expected, power, strict=True)]
    best, choice = solutions, 0.0
    for taken in range(n_ants // 2):
        gains = np.sum([_gains(design, *one) for one in zip(expected, power, solutions, strict=True)], axis=0)
        prior[1 + np.argmax(np.where(prior[1:] > HELD, -1.0, gains))] = WIDTH_OF_FEW
        solutions = [_solve(design, *pair, prior) for pair in zip(expected, power, strict=True)]
        cost = choice + np.log((n_ants - taken) / (taken + 1))
        if taken and _evidence(solutions) - cost <= _evidence(best) - choice + MIN_MORE:
            break
        best, choice = solutions, cost
    return best, choice


def _gains(design: csr_array, expected: FloatArray, power: FloatArray, solution: _Solution) -> FloatArray:
    """Return by how much ln L would rise if each antenna's scale were free, to second order, (Nants,)."""
    scaled = power * np.exp(-(design @ solution.x))
    slope, curvature = design.T @ (scaled - expected), (design**2).T @ scaled
    return np.asarray(slope**2 / np.maximum(2 * curvature, 1e-300))[1:]


def _evidence(solutions: list[_Solution]) -> float:
    """Return the log Bayes factor of all channels."""
    return float(sum(one.log_bayes_factor for one in solutions))


def _solve(design: csr_array, expected: FloatArray, power: FloatArray, width: FloatArray) -> _Solution:
    """Maximise the posterior of one channel and take the evidence around the maximum."""
    x = np.zeros(len(width))
    if not power.any() or not expected.any():
        return _Solution(x, np.diag(width**2), 0.0, 0.0)
    x[0] = 0.5 * np.log(power.sum() / expected.sum())

    def loss(at: FloatArray) -> float:
        eta = design @ at
        with np.errstate(over="ignore"):  # a step that is far too long
            return float(expected @ eta + power @ np.expm1(-eta) + 0.5 * np.sum((at / width) ** 2))

    for _ in range(100):
        scaled = power * np.exp(-(design @ x))
        curvature = (design.T @ (design * scaled[:, np.newaxis])).toarray() + np.diag(width**-2)
        factor = cho_factor(curvature)
        step = cho_solve(factor, design.T @ (scaled - expected) - x / width**2)
        length, here = 1.0, loss(x)
        while loss(x + length * step) > here and length > 1e-6:
            length *= 0.5
        x = x + length * step
        if np.abs(step).max() < 1e-9:
            break
    log_det = 2 * float(np.log(np.diag(factor[0]) * width).sum())
    likelihood = 0.5 * float(np.sum((x / width) ** 2)) - loss(x)
    told = np.diag(np.where(width > HELD, 1.0, 0.0))
    if len(x) > 1 and np.all(width > HELD):
        told[0, 1:] = 1 / (len(x) - 1)
        told[1:, 1:] -= 1 / (len(x) - 1)
    covariance = told @ cho_solve(factor, told.T)
    return _Solution(told @ x, covariance, -loss(x) - 0.5 * log_det, 2 * likelihood)
