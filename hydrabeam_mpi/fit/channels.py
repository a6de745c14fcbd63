"""The inference of the channels of a rank group: accumulate, sum over ranks, solve, check, describe."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from hydrabeam_mpi.fit.accumulate import accumulate, check_heldout
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.rows import Rows, read_rows
from hydrabeam_mpi.infer.posterior import Posterior
from hydrabeam_mpi.infer.predictive_checks import Z_EDGES, HeldoutStatistics
from hydrabeam_mpi.io.finite import INFERENCE, check_finite
from hydrabeam_mpi.io.noise import check_weights
from hydrabeam_mpi.io.posterior_file import ChannelRecord
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_max, allreduce_sum, bcast_array, together
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.result.summary import (
    SkyMaps,
    eigenbeams,
    evaluate_on_grid,
    map_posterior,
    summarise_coefficients,
    summarise_maps,
)
from hydrabeam_mpi.setup.problem import Problem


@dataclass
class Clock:
    """Wall-clock seconds a phase, as one rank sees them."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def time(self, phase: str) -> Iterator[None]:
        """Add the time that the block takes to ``phase``."""
        start = time.perf_counter()
        yield
        self.seconds[phase] = self.seconds.get(phase, 0.0) + time.perf_counter() - start

    @property
    def inference(self) -> float:
        """Seconds from the data in memory to the posterior mean and covariance (HDBI II, section 4.1)."""
        return self.seconds["design"] + self.seconds["solve"]


@dataclass(frozen=True)
class ChannelResult:
    """What was inferred of one channel.

    Attributes
    ----------
    normal : NormalEquations
        Summed over all training rows.
    posterior : Posterior
    heldout : HeldoutStatistics
        Summed over all held-out rows.
    """

    normal: NormalEquations
    posterior: Posterior
    heldout: HeldoutStatistics


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
    with clock.time("design"):
        normals = _sum_normals(grid, problem, train)
    with clock.time("solve"):
        posteriors = solve_channels(grid, problem, normals)
    with clock.time("heldout"):
        heldout = _sum_heldout(grid, problem, test, posteriors)
    return [ChannelResult(*parts) for parts in zip(normals, posteriors, heldout, strict=True)]


def read_shares(grid: ProcessGrid, problem: Problem, whole_times: bool = False) -> tuple[Rows, Rows]:
    """Read the rank's training and held-out rows; ``whole_times`` keeps held-out rows of the same time together.

    Collective: all ranks of `grid.world`.
    """
    with together(grid.world):
        train = read_rows(problem, problem.tile_of(problem.train, grid.group.rank, grid.group.size))
        test = read_rows(problem, problem.tile_of(problem.test, grid.group.rank, grid.group.size, whole_times))
    counts = np.array([train.n_unflagged, np.count_nonzero(train.inv_noise_var)])
    allreduce_sum(grid.world, counts)
    with together(grid.world):
        check_weights(int(counts[0]), int(counts[1]), problem.files)
    return train, test


def _sum_normals(grid: ProcessGrid, problem: Problem, rows: Rows) -> list[NormalEquations]:
    """Accumulate the rank's rows and sum over the group."""
    with together(grid.world):
        normals = accumulate(rows, problem.forward_model(rows.groups), problem.basis, show=grid.world.rank == 0)
    for normal in normals:
        normal.reduce(grid.group)
    return normals


def solve_channels(grid: ProcessGrid, problem: Problem, normals: list[NormalEquations]) -> list[Posterior]:
    """Solve on the group's root and share the posterior, which every rank needs for its held-out rows.

    Collective: all ranks of `grid.world`.
    """
    solved: list[Posterior] = []
    with together(grid.world):
        if grid.is_group_root:
            pairs = zip(normals, problem.priors, strict=True)
            solved = [normal.gaussian({BEAM: prior}).solve(overwrite=True) for normal, prior in pairs]
            for number, posterior in zip(problem.channel_numbers.tolist(), solved, strict=True):
                numbers = {"posterior mean": posterior.mean, "posterior precision": np.diag(posterior.factor)}
                check_finite(f"channel {number}", numbers, INFERENCE)
    for f in range(len(normals)):
        root = solved[f] if grid.is_group_root else None
        mean = bcast_array(grid.group, root.mean if root else None)
        factor = bcast_array(grid.group, root.factor if root else None)
        if not root:
            solved.append(Posterior(mean, factor))
    with together(grid.world):
        for posterior in solved if grid.is_group_root else ():
            _ = posterior.covariance  # cached: part of the inference, though only written later
    return solved


def _sum_heldout(
    grid: ProcessGrid, problem: Problem, rows: Rows, posteriors: list[Posterior]
) -> list[HeldoutStatistics]:
    """Check the rank's held-out rows and combine the statistics of the group."""
    with together(grid.world):
        model = problem.forward_model(rows.groups)
        statistics = check_heldout(rows, model, problem.basis, posteriors, problem.beams, show=grid.world.rank == 0)
    reduce_heldout(grid, statistics)
    return statistics


def reduce_heldout(grid: ProcessGrid, statistics: list[HeldoutStatistics]) -> None:
    """Combine the statistics of the group, in place. Collective: all ranks of `grid.group`."""
    for one in statistics:
        allreduce_sum(grid.group, one.sums)
        allreduce_sum(grid.group, one.counts)
        allreduce_max(grid.group, one.largest)


def describe_channels(grid: ProcessGrid, problem: Problem, results: list[ChannelResult]) -> list[ChannelRecord]:
    """Collect what is written of each channel: maps, eigenbeams, draws and summary numbers.

    Collective: all ranks of `grid.group`, which share out the maps.

    Returns
    -------
    list of ChannelRecord
        On the group's root; empty on other ranks.
    """
    records = []
    for f, result in enumerate(results):
        mean, std = map_posterior(grid.group, result.posterior, problem.basis)
        if grid.is_group_root:
            truth = evaluate_on_grid(problem.truths[f]) if problem.truths else None
            maps = SkyMaps(mean, std, evaluate_on_grid(problem.beams[f]), truth)
            records.append(_record(problem, f, result, maps))
    return records


def _record(problem: Problem, f: int, result: ChannelResult, maps: SkyMaps) -> ChannelRecord:
    """Put together one channel's numbers and arrays; see `hydrabeam_mpi.io.posterior_file`."""
    prior, posterior = problem.priors[f], result.posterior
    variances, beams = eigenbeams(posterior, problem.basis)
    draws = [
        posterior.draw(generator(problem.job.seed, "posterior draw", int(problem.channel_numbers[f]), draw))
        for draw in range(problem.job.output.draws)
    ]
    summary = {
        "freq_hz": float(problem.observation.freqs[f]),
        "n_data": result.normal.n_data,
        "n_unique_baselines": problem.n_unique_baselines,
        "n_modes": problem.basis.n_modes,
        "log_evidence": posterior.log_evidence,
        "train_chi2": reduced_chi2(result.normal, posterior),
        "fit_rms": problem.fit_rms[f],
    }
    summary |= summarise_coefficients(posterior, prior) | summarise_maps(maps) | result.heldout.summary()
    arrays = {
        "mean": posterior.mean,
        "covariance": posterior.covariance,
        "std": posterior.std,
        "prior_mean": prior.mean,
        "prior_std": prior.std(),
        "draws": np.array(draws).reshape(len(draws), len(posterior.mean)),
        "map_mean": maps.mean,
        "map_std": maps.std,
        "map_model": maps.model,
        "eigen_variances": variances,
        "eigen_beams": beams,
        "z_edges": Z_EDGES,
        "z_counts": result.heldout.counts,
    }
    if maps.truth is not None:
        arrays["map_truth"] = maps.truth
    return ChannelRecord(float(problem.observation.freqs[f]), summary, arrays, posterior.log_evidence)


def reduced_chi2(normal: NormalEquations, posterior: Posterior) -> float:
    """Reduced chi^2 of the fitted data at the posterior mean: d^H N^-1 d - 2 Re x^H p + x^H G x over their number."""
    mean = posterior.mean
    quadratic = np.vdot(mean, normal.own(BEAM) @ mean).real - 2 * np.vdot(mean, normal.projection[BEAM]).real
    return float((normal.data_norm + quadratic) / max(normal.n_data, 1))
