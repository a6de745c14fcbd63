"""The inference of the channels of a rank group: read, accumulate, sum over ranks, solve, check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.fit.accumulate import Accumulator, HeldoutCheck
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.coupled import CoupledChannel, CoupledSolution, solve_coupled
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.heldout_sample import heldout_sample
from hydrabeam_mpi.fit.rounding import MOST_SHIFT, Rounding
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.shared_design import SharedDesign
from hydrabeam_mpi.fit.shares import read_shares_of_each
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.predictive_checks import HeldoutStatistics
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.io.finite import INFERENCE, check_finite
from hydrabeam_mpi.model.engines.base import Precision
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_max, allreduce_sum, bcast_array, together
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.progress import say


@dataclass(frozen=True)
class ChannelResult:
    """What was inferred of one channel.

    Attributes
    ----------
    normal : NormalEquations
        Summed over all training rows.
    train_chi2 : float
        Reduced chi^2 of these at the posterior mean.
    posterior : Posterior
    heldout : HeldoutStatistics
        Summed over all held-out rows.
    arrays : dict
        What else is kept, by the names that it has in ``posterior.h5``: the sample of held-out rows, and with effects
        in the model their joint errors.
    rounding_shift : float or None
        How far, in its std, single precision was expected to move a posterior mean of any channel; beyond `MOST_SHIFT`
        all was repeated in double. None in double precision.
    coupled : CoupledChannel, optional
        Where it hangs together with others, what is kept of that; on the group's root.
    """

    normal: NormalEquations
    train_chi2: float
    posterior: Posterior
    heldout: HeldoutStatistics
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    rounding_shift: float | None = None
    coupled: CoupledChannel | None = None


def infer_channels(grid: ProcessGrid, problem: Problem, clock: Clock) -> list[ChannelResult]:
    """Infer the beams of this group's channels: one polarisation alone, as of `infer_each`."""
    return infer_each(grid, [problem], clock)[0]


def infer_each(grid: ProcessGrid, problems: Sequence[Problem], clock: Clock) -> list[list[ChannelResult]]:
    """Infer the beams of this group's channels, of several polarisations.

    Their data are read at once, and the design of each time, which depends on sky, array and functions alone, is
    computed once for all.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problems : sequence of Problem
        Of this group's channels; they differ in the polarisation alone, and in what follows from that.
    clock : Clock
        Receives the seconds of the phases "read", "design", "solve" and "heldout".

    Returns
    -------
    list of list of ChannelResult
        Those of each problem; on every rank of the group.
    """
    with clock.time("read"):
        train, test = read_shares_of_each(grid, problems)
    mixed = problems[0].job.solver.precision == "mixed"
    solved = infer_rows(grid, problems, train, clock, np.float32 if mixed else np.float64)
    shifts = [one.rounding_shift for one in solved]
    if again := [p for p, shift in enumerate(shifts) if shift > MOST_SHIFT]:
        told = (
            f"single precision would move the posterior mean by up to {max(shifts):.1e} std; all is computed in double"
        )
        say(told, grid.is_world_root)
        anew = infer_rows(grid, [problems[p] for p in again], [train[p] for p in again], clock, np.float64)
        for p, one in zip(again, anew, strict=True):
            solved[p] = one
    with clock.time("heldout"):
        checked = _sum_heldout(grid, problems, test, [one.posteriors for one in solved])
    return [
        one.results(heldout, samples, shift if mixed else None)
        for one, (heldout, samples), shift in zip(solved, checked, shifts, strict=True)
    ]


@dataclass(frozen=True)
class Solved:
    """What follows from the training rows of one polarisation; see `ChannelResult`."""

    normals: list[NormalEquations]
    posteriors: list[Posterior]
    coupled: list[CoupledChannel]
    rounding_shift: float

    def results(
        self, heldout: list[HeldoutStatistics], samples: list[dict[str, Array]], shift: float | None
    ) -> list[ChannelResult]:
        """Return the channels' results with what the held-out rows say."""
        chi2 = map(reduced_chi2, self.normals, self.posteriors)
        parts = zip(self.normals, chi2, self.posteriors, heldout, samples, strict=True)
        results = [ChannelResult(*part, rounding_shift=shift) for part in parts]
        if not self.coupled:
            return results
        return [replace(one, coupled=told) for one, told in zip(results, self.coupled, strict=True)]


def infer_rows(
    grid: ProcessGrid, problems: Sequence[Problem], train: Sequence[Rows], clock: Clock, precision: Precision
) -> list[Solved]:
    """Infer from the rank's training rows, and tell how far rounding may have moved the mean, in std, of any channel.

    Collective: all ranks of `grid.world`.
    """
    in_single = precision == np.float32
    with clock.time("design"):
        roundings = [Rounding(grid.group, *pair) for pair in zip(problems, train, strict=True)] if in_single else []
        normals = _sum_normals(grid, problems, train, precision, roundings)
    with clock.time("solve"):
        of_each = zip(problems, normals, roundings or len(problems) * [None], strict=True)
        return [_solve(grid, *one) for one in of_each]


def _solve(grid: ProcessGrid, problem: Problem, normals: list[NormalEquations], rounding: Rounding | None) -> Solved:
    """Solve for one polarisation. Collective: all ranks of `grid.world`."""
    posteriors, solution = solve_channels(grid, problem, normals, n_draws=problem.job.output.draws)
    coupled = solution.channels if solution else []
    # The matrix of all channels is of no use any more.
    del solution
    with together(grid.world), grid.roots_alone():
        for posterior in posteriors if grid.is_group_root else ():
            _ = posterior.covariance  # cached: part of the inference, though only written later
    worst = np.zeros(1)
    if rounding is not None:
        worst[0] = rounding.shifts(grid, posteriors).max(initial=0.0)
        allreduce_max(grid.world, worst)
    return Solved(normals, posteriors, coupled, float(worst[0]))


def _sum_normals(
    grid: ProcessGrid,
    problems: Sequence[Problem],
    rows: Sequence[Rows],
    precision: Precision,
    roundings: Sequence[Rounding] = (),
) -> list[list[NormalEquations]]:
    """Accumulate the rank's rows and sum over the group."""
    with together(grid.world):
        design = SharedDesign(problems, rows, precision)
        takers = [
            Accumulator(one, problem.basis, about=_start(problem)) for one, problem in zip(rows, problems, strict=True)
        ]
        for t, of_each in design.by_time("design matrix", show=grid.is_world_root):
            for rounding, own in zip(roundings, of_each, strict=bool(roundings)):
                rounding.watch(t, own)
            for taker, own in zip(takers, of_each, strict=True):
                taker.add(t, own)
        normals = [taker.finish() for taker in takers]
    for normal in chain(*normals):
        normal.reduce(grid.group)
    return normals


def _start(problem: Problem) -> list[Array] | None:
    """Return the coefficients of each channel, (n_modes,), from which beams are counted: those of the prior's mean.

    What rounding makes of the sums is then in proportion to how far the beam is from these. None where channels hang
    together, for which beams are counted from zero.
    """
    return None if problem.coupling is not None else [prior.mean for prior in problem.priors]


def solve_channels(
    grid: ProcessGrid,
    problem: Problem,
    normals: list[NormalEquations],
    factors: Sequence[Array] | None = None,
    n_draws: int = 0,
) -> tuple[list[Posterior], CoupledSolution | None]:
    """Solve on the group's root and share the posterior, which every rank needs for its held-out rows.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the group's channels.
    normals : list of NormalEquations
    factors : sequence of ndarray, (n, n), optional
        The channels' factors of the precision, on all ranks, where they are known and channels are independent.
    n_draws : int
        How many draws are made of channels that hang together.

    Returns
    -------
    list of Posterior
    CoupledSolution, optional
        Where channels hang together.
    """
    solved: list[Posterior] = []
    coupled = None
    if problem.coupling is not None:
        coupled = solve_coupled(grid, problem, normals, n_draws)
        solved = coupled.posteriors
    with together(grid.world), grid.roots_alone():
        if grid.is_group_root:
            if problem.coupling is None:
                parts = zip(normals, problem.priors, factors or len(normals) * (None,), strict=True)
                solved = [_posterior(*part) for part in parts]
            for number, posterior in zip(problem.channel_numbers.tolist(), solved, strict=True):
                numbers = {"posterior mean": posterior.mean, "posterior precision": np.diag(posterior.factor)}
                check_finite(f"channel {number}", numbers, INFERENCE)
    for f in range(len(normals)):
        root = solved[f] if grid.is_group_root else None
        mean = bcast_array(grid.group, root.mean if root else None)
        factor = factors[f] if factors else bcast_array(grid.group, root.factor if root else None)
        if not root:
            solved.append(Posterior(mean, factor))
    return solved, coupled


def _posterior(normal: NormalEquations, prior: Prior, factor: Array | None) -> Posterior:
    """Return the posterior of one channel's coefficients."""
    found = normal.gaussian({BEAM: prior}).solve(True, factor)
    return replace(found, mean=found.mean + normal.about.get(BEAM, 0.0))


def _sum_heldout(
    grid: ProcessGrid, problems: Sequence[Problem], rows: Sequence[Rows], posteriors: Sequence[list[Posterior]]
) -> list[tuple[list[HeldoutStatistics], list[dict[str, Array]]]]:
    """Check the rank's held-out rows, and combine the statistics of the group and a sample of its rows."""
    with together(grid.world):
        before = [
            problem.forward_model(own.groups).visibilities(problem.beams, own.tile.times)
            for problem, own in zip(problems, rows, strict=True)
        ]
        checks = [
            HeldoutCheck(own, found, seen, models=problem.model_means)
            for problem, own, found, seen in zip(problems, rows, posteriors, before, strict=True)
        ]
        for t, of_each in SharedDesign(problems, rows).by_time("held-out rows", show=grid.is_world_root):
            for check, design in zip(checks, of_each, strict=True):
                check.add(t, design)
    found = []
    for problem, own, seen, check in zip(problems, rows, before, checks, strict=True):
        reduce_heldout(grid, check.statistics)
        found.append((check.statistics, heldout_sample(grid, problem, own, seen, own, check.after)))
    return found


def reduce_heldout(grid: ProcessGrid, statistics: list[HeldoutStatistics]) -> None:
    """Combine the statistics of the group, in place. Collective: all ranks of `grid.group`."""
    for one in statistics:
        allreduce_sum(grid.group, one.sums)
        allreduce_sum(grid.group, one.counts)
        allreduce_max(grid.group, one.largest)


def reduced_chi2(normal: NormalEquations, posterior: Posterior) -> float:
    """Reduced chi^2 of the fitted data at the posterior mean: d^H N^-1 d - 2 Re x^H p + x^H G x over their number."""
    return normal.misfit(BEAM, posterior.mean) / max(normal.n_data, 1)
