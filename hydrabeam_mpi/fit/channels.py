"""The inference of the channels of a rank group: read, accumulate, sum over ranks, solve, check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.fit.accumulate import accumulate_designs, check_designs, designs
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.coupled import CoupledChannel, CoupledSolution, solve_coupled
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.heldout_sample import heldout_sample
from hydrabeam_mpi.fit.rounding import MOST_SHIFT, Rounding
from hydrabeam_mpi.fit.rows import Rows, read_rows
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.predictive_checks import HeldoutStatistics
from hydrabeam_mpi.io.finite import INFERENCE, check_finite
from hydrabeam_mpi.io.noise import check_weights
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
    """Infer the beams of this group's channels.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of this group's channels.
    clock : Clock
        Receives the seconds of the phases "read", "design", "solve" and "heldout".

    Returns
    -------
    list of ChannelResult
        On every rank of the group.
    """
    with clock.time("read"):
        train, test = read_shares(grid, problem)
    mixed = problem.job.solver.precision == "mixed"
    normals, posteriors, coupled, shift = infer_rows(grid, problem, train, clock, np.float32 if mixed else np.float64)
    if shift > MOST_SHIFT:
        told = f"single precision would move the posterior mean by up to {shift:.1e} std; all is computed in double"
        say(told, grid.is_world_root)
        normals, posteriors, coupled, _ = infer_rows(grid, problem, train, clock, np.float64)
    with clock.time("heldout"):
        heldout, samples = _sum_heldout(grid, problem, test, posteriors)
    chi2 = map(reduced_chi2, normals, posteriors)
    parts = zip(normals, chi2, posteriors, heldout, samples, strict=True)
    results = [ChannelResult(*part, rounding_shift=shift if mixed else None) for part in parts]
    return [replace(one, coupled=two) for one, two in zip(results, coupled, strict=True)] if coupled else results


def sum_channels(grid: ProcessGrid, problem: Problem, clock: Clock) -> tuple[list[NormalEquations], Rows]:
    """Return the sums over all training rows of each of the group's channels, and the rank's held-out rows.

    Collective: all ranks of `grid.world`. ``clock`` receives the phases "read" and "design".
    """
    with clock.time("read"):
        train, test = read_shares(grid, problem)
    with clock.time("design"):
        return _sum_normals(grid, problem, train, np.float64, None), test


def infer_rows(
    grid: ProcessGrid, problem: Problem, train: Rows, clock: Clock, precision: Precision
) -> tuple[list[NormalEquations], list[Posterior], list[CoupledChannel], float]:
    """Infer from the rank's training rows, and tell how far rounding may have moved the mean, in std, of any channel.

    Collective: all ranks of `grid.world`.
    """
    in_single = precision == np.float32
    with clock.time("design"):
        rounding = Rounding(grid.group, problem, train) if in_single else None
        normals = _sum_normals(grid, problem, train, precision, rounding)
    with clock.time("solve"):
        posteriors, solution = solve_channels(grid, problem, normals, n_draws=problem.job.output.draws)
        coupled = solution.channels if solution else []
        # The matrix of all channels is of no use any more.
        del solution
        with together(grid.world):
            for posterior in posteriors if grid.is_group_root else ():
                _ = posterior.covariance  # cached: part of the inference, though only written later
        worst = np.zeros(1)
        if rounding is not None:
            worst[0] = rounding.shifts(grid, posteriors).max(initial=0.0)
            allreduce_max(grid.world, worst)
    return normals, posteriors, coupled, float(worst[0])


def read_shares(grid: ProcessGrid, problem: Problem, whole_times: bool = False) -> tuple[Rows, Rows]:
    """Read the rank's training and held-out rows; ``whole_times`` keeps held-out rows of the same time together.

    Collective: all ranks of `grid.world`.
    """
    return read_share(grid, problem, problem.train), read_share(grid, problem, problem.test, whole_times, False)


def read_share(
    grid: ProcessGrid, problem: Problem, rows: Tile, whole_times: bool = False, must_count: bool = True
) -> Rows:
    """Read the rank's share of some rows, some of which ``must_count``. Collective: all ranks of `grid.world`."""
    with together(grid.world):
        mine = read_rows(problem, problem.tile_of(rows, grid.group.rank, grid.group.size, whole_times))
    counts = np.array([mine.n_unflagged, np.count_nonzero(mine.inv_noise_var)])
    allreduce_sum(grid.world, counts)
    with together(grid.world):
        if must_count:
            check_weights(int(counts[0]), int(counts[1]), problem.files)
    return mine


def _sum_normals(
    grid: ProcessGrid, problem: Problem, rows: Rows, precision: Precision, rounding: Rounding | None
) -> list[NormalEquations]:
    """Accumulate the rank's rows and sum over the group."""
    with together(grid.world):
        model = problem.forward_model(rows.groups, precision)
        by_time = designs(rows, model, problem.basis, "design matrix", show=grid.is_world_root)
        normals = accumulate_designs(rows, rounding.watch(by_time) if rounding else by_time, problem.basis)
    for normal in normals:
        normal.reduce(grid.group)
    return normals


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
    with together(grid.world):
        if grid.is_group_root:
            if problem.coupling is None:
                parts = zip(normals, problem.priors, factors or len(normals) * (None,), strict=True)
                solved = [normal.gaussian({BEAM: prior}).solve(True, factor) for normal, prior, factor in parts]
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


def _sum_heldout(
    grid: ProcessGrid, problem: Problem, rows: Rows, posteriors: list[Posterior]
) -> tuple[list[HeldoutStatistics], list[dict[str, Array]]]:
    """Check the rank's held-out rows, and combine the statistics of the group and a sample of its rows."""
    with together(grid.world):
        model = problem.forward_model(rows.groups)
        before = model.visibilities(problem.beams, rows.tile.times)
        by_time = designs(rows, model, problem.basis, "held-out rows", show=grid.is_world_root)
        statistics, after = check_designs(rows, by_time, posteriors, before)
    reduce_heldout(grid, statistics)
    return statistics, heldout_sample(grid, problem, rows, before, rows, after)


def reduce_heldout(grid: ProcessGrid, statistics: list[HeldoutStatistics]) -> None:
    """Combine the statistics of the group, in place. Collective: all ranks of `grid.group`."""
    for one in statistics:
        allreduce_sum(grid.group, one.sums)
        allreduce_sum(grid.group, one.counts)
        allreduce_max(grid.group, one.largest)


def reduced_chi2(normal: NormalEquations, posterior: Posterior) -> float:
    """Reduced chi^2 of the fitted data at the posterior mean: d^H N^-1 d - 2 Re x^H p + x^H G x over their number."""
    return normal.misfit(BEAM, posterior.mean) / max(normal.n_data, 1)
