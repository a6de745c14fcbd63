"""Checks before any fit: whether the data follow another convention than the one stated.

The model beam's visibilities, nothing of which is fitted, are compared with the data as they are and under each
alternative, at a few times. A wrong convention is no small error: under the right one most of the residual is gone.
Small errors are left to the effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.inference.robust import STRONG
from hydrabeam_mpi.io.uvsource import as_source
from hydrabeam_mpi.loop.checks.alternatives import (
    Alternative,
    AntennaTable,
    array_alternatives,
    basic_alternatives,
    predictions,
    sky_alternatives,
    time_alternatives,
)
from hydrabeam_mpi.loop.checks.scale import CALIBRATED, UNCALIBRATED
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum, bcast_object, together
from hydrabeam_mpi.setup.findings import Finding
from hydrabeam_mpi.setup.problem import Problem

N_TIMES = 8
MIN_FALL = 1000.0  # of chi^2, by which the right convention is better at least
LEFT = 0.25  # of the residual power, that it leaves at most
CLOCK_LEFT = 0.5  # the same of a clock, or of a sky elsewhere, which shifts phases by little on short baselines
AMPLITUDE_TOLERANCE = 0.2
FLUX_SCALES = 0.05
"""Spread of ln flux between the scales of catalogues, some per cent. The data of one array cannot tell it."""
PROBE = 2.0  # s, on either side of a clock's offset

FACTORS = {
    factor: (
        f"factor {name}",
        f"multiply data and noise by {1 / factor:g} ([data] flux_scale), or set [data] pol_convention = {sum_or_avg!r} "
        f"where the files do not state theirs: for V = I B / 2 the data are {name} times as large as they should be",
    )
    for factor, name, sum_or_avg in ((2.0, "2", "avg"), (0.5, "1/2", "sum"))
}


@dataclass(frozen=True)
class Score:
    """How the data compare with the model under one convention, all channels together.

    Attributes
    ----------
    n : float
        Number of visibilities.
    data : float
        sum w |d|^2.
    overlap, model : float
        sum w Re(d* m) and sum w |m|^2.
    """

    n: float
    data: float
    overlap: float
    model: float

    @property
    def amplitude(self) -> float:
        """Of the model, best."""
        return self.overlap / self.model if self.model else 0.0

    @property
    def chi2(self) -> float:
        """With the best amplitude."""
        return self.data - self.amplitude * self.overlap

    @property
    def excess(self) -> float:
        """Residual power beyond the noise."""
        return max(self.chi2 - self.n, 0.0)

    @property
    def explained(self) -> float:
        """Fraction of the data's power beyond the noise."""
        return 1 - self.excess / (self.data - self.n) if self.data > self.n else 0.0

    def leaves_less(self, stated: Score, left: float) -> bool:
        """Tell whether this leaves significantly less than a fraction of the stated convention's residual power."""
        return self.excess < left * stated.excess and stated.chi2 - self.chi2 > MIN_FALL

    def betters(self, stated: Score, left: float) -> bool:
        """Tell whether this leaves less, at the model's flux scale."""
        return self.leaves_less(stated, left) and abs(self.amplitude - 1) < AMPLITUDE_TOLERANCE


def check_conventions(grid: ProcessGrid, problem: Problem, rows: Rows) -> dict[str, Any]:
    """Find out whether the data follow another convention than the one stated.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of this group's channels.
    rows : Rows
        The rank's training rows, as read.

    Returns
    -------
    dict
        ``found`` (a name, or None), ``remedy``, and ``tested``: for every convention its ``name``, reduced ``chi2``
        with the best ``amplitude``, and the fraction of the data's power beyond the noise that it has ``explained``.
    """
    observation = problem.observation
    table = None
    with together(grid.world):
        if grid.is_world_root:
            table = _antenna_table(problem)
    table = bcast_object(grid.world, table)
    alternatives = basic_alternatives() + array_alternatives(observation, table, problem.job.data.redundancy_tol)
    alternatives += sky_alternatives(problem) + time_alternatives(observation)
    scores = score_alternatives(grid, problem, rows, alternatives)
    stated, candidates = scores[0], _factor(scores[0])
    timed = []
    for one, score in zip(alternatives[1:], scores[1:], strict=True):
        if one.tolerance is not None and score.betters(stated, CLOCK_LEFT):
            timed.append((score, one))
        elif one.tolerance is None and score.betters(stated, LEFT):
            candidates[one.name] = score, one.remedy
    for score, one in sorted(timed, key=lambda pair: pair[0].chi2)[:1]:
        if _is_met(grid, problem, rows, one, score):
            candidates[one.name] = score, one.remedy
    found = min(candidates, key=lambda name: candidates[name][0].chi2, default=None)
    return {
        "found": found,
        "remedy": None if found is None else candidates[found][1],
        "tested": [_entry(one.name, score) for one, score in zip(alternatives, scores, strict=True)],
    }


def with_findings(conventions: dict[str, Any], findings: Sequence[Finding]) -> dict[str, Any]:
    """Return what `check_conventions` told, with a convention that the health of the data has shown in its place."""
    broken = next((one for one in findings if one.convention), None)
    return conventions if broken is None else conventions | {"found": broken.convention, "remedy": broken.remedy}


def _entry(name: str, score: Score) -> dict[str, Any]:
    return {
        "name": name,
        "chi2": score.chi2 / max(score.n, 1.0),
        "amplitude": score.amplitude,
        "explained": score.explained,
    }


def _antenna_table(problem: Problem) -> AntennaTable:
    """Read the antennas in the order of the first file that has all of the observation's."""
    wanted = set(problem.observation.antenna_numbers.tolist())
    for data in problem.files:
        header, _ = as_source(data).metadata()
        if wanted <= set(header.antenna_numbers.tolist()):
            return AntennaTable(header.antenna_numbers, header.antenna_names, header.antpos)
    observation = problem.observation
    return AntennaTable(observation.antenna_numbers, observation.antenna_names, observation.antpos)


def sample_times(times: IntArray, most: int = N_TIMES) -> IntArray:
    """Choose up to ``most`` of some times, evenly spread, first and last among them, (Nchosen,)."""
    return times[np.unique(np.linspace(0, len(times) - 1, min(most, len(times))).round().astype(int))]


def _products(weight: FloatArray, data: ComplexArray, model: ComplexArray) -> tuple[float, float]:
    """Return sum w Re(d* m) and sum w |m|^2."""
    return float(np.sum(weight * (data.conj() * model).real)), float(np.sum(weight * np.abs(model) ** 2))


def score_alternatives(
    grid: ProcessGrid, problem: Problem, rows: Rows, alternatives: Sequence[Alternative]
) -> list[Score]:
    """Compare a few times of the data with every alternative, over all ranks.

    Collective: all ranks of `grid.world`. ``problem`` is of the group's channels, ``rows`` are the rank's.
    """
    products = np.zeros((len(alternatives), 2))
    common = np.zeros(2)
    with together(grid.world):
        chosen = np.flatnonzero(np.isin(rows.tile.times, sample_times(problem.train.times)))
        weights, data = rows.inv_noise_var[:, chosen], rows.data[:, chosen]
        common += np.count_nonzero(weights), np.sum(weights * np.abs(data) ** 2)
        if len(rows.tile.bls):
            for n, t, vis in predictions(problem, rows, alternatives, chosen):
                seen = rows.data[:, t].conj() if alternatives[n].conjugated else rows.data[:, t]
                products[n] += _products(rows.inv_noise_var[:, t], seen, vis)
    allreduce_sum(grid.world, products)
    allreduce_sum(grid.world, common)
    return [Score(*common.tolist(), *pair) for pair in products.tolist()]


def _factor(stated: Score) -> dict[str, tuple[Score, str]]:
    """Return the factor by which all data are wrong, if there is one; see `factor_log_odds`."""
    found = {}
    for factor, (name, remedy) in FACTORS.items():
        beside_stated, beside_any = factor_log_odds(stated, factor)
        if beside_stated >= STRONG and beside_any > 0:
            found[name] = stated, remedy
    return found


def factor_log_odds(stated: Score, factor: float) -> tuple[float, float]:
    """Return the log odds that data have just this factor, beside none and beside any scale.

    By how much calibrated data may differ from their model in size the data tell: what is wrong with the beam or the
    sky is not all of the model's own shape. Where one scale leaves q of the data's amplitude, it is right within
    -ln(1 - q), beside what flux scales differ by and the error by noise. Any scale is one that `checks.scale` expects,
    of data that are calibrated or not.
    """
    if not (stated.amplitude > 0 and stated.explained > 0):
        return -np.inf, -np.inf
    left = float(np.sqrt(1 - min(stated.explained, 1.0)))
    noise = 1 / (stated.amplitude * np.sqrt(2 * stated.model))
    width = float(np.hypot(np.hypot(FLUX_SCALES, np.log1p(-left)), noise))
    value = float(np.log(stated.amplitude))

    def log_density(centre: float, spread: float) -> float:
        # But for a constant, as only its differences count.
        return float(-0.5 * ((value - centre) / spread) ** 2 - np.log(spread))

    with_factor = log_density(float(np.log(factor)), width)
    any_scale = max(log_density(0.0, CALIBRATED), log_density(0.0, UNCALIBRATED))
    return with_factor - log_density(0.0, width), with_factor - any_scale


def _is_met(grid: ProcessGrid, problem: Problem, rows: Rows, one: Alternative, score: Score) -> bool:
    """Tell whether the times are wrong by exactly what that alternative says. Collective: all ranks of `grid.world`.

    A parabola through chi^2 on both sides has its minimum there: a timestamp that is wrong by anything else is not a
    matter of convention.
    """
    assert one.shift is not None
    assert one.tolerance is not None
    probes = [replace(one, shift=one.shift + sign * PROBE) for sign in (-1, 1)]
    before, after = (one.chi2 for one in score_alternatives(grid, problem, rows, probes))
    bend = before + after - 2 * score.chi2
    if bend <= 0:
        return False
    offset = 0.5 * PROBE * (before - after) / bend
    std = PROBE * np.sqrt(2 / bend * max(score.chi2 / score.n, 1.0))
    return bool(abs(offset) < one.tolerance and std < 0.5 * one.tolerance)
