"""What is written of each channel: maps, eigenbeams, draws and summary numbers."""

from __future__ import annotations

from hydrabeam_mpi.fit.channels import ChannelResult
from hydrabeam_mpi.inference.predictive_checks import Z_EDGES
from hydrabeam_mpi.io.posterior_file import ChannelRecord
from hydrabeam_mpi.mpi import ProcessGrid
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
    key = problem.job.seed, "posterior draw", int(problem.channel_numbers[f])
    coupled = result.coupled
    if coupled is None:
        draws = posterior.draws([generator(*key, draw) for draw in range(problem.job.output.draws)])
    else:
        draws = coupled.draws
    summary = {
        "freq_hz": float(problem.observation.freqs[f]),
        "n_data": result.normal.n_data,
        "n_unique_baselines": problem.n_unique_baselines,
        "n_modes": problem.basis.n_modes,
        "log_evidence": posterior.log_evidence,
        "train_chi2": result.train_chi2,
        "fit_rms": problem.fit_rms[f],
    }
    summary |= summarise_coefficients(posterior, prior) | summarise_maps(maps) | result.heldout.summary()
    arrays = {
        "mean": posterior.mean,
        "covariance": posterior.covariance,
        "std": posterior.std,
        "prior_mean": prior.mean,
        "prior_std": prior.std(),
        "draws": draws,
        "map_mean": maps.mean,
        "map_std": maps.std,
        "map_model": maps.model,
        "eigen_variances": variances,
        "eigen_beams": beams,
        "z_edges": Z_EDGES,
        "z_counts": result.heldout.counts,
        **result.arrays,
    }
    if coupled is not None:
        arrays |= coupled.told
    if problem.earlier is not None:
        arrays["model_mean"] = problem.model_means[f]
    if maps.truth is not None:
        arrays["map_truth"] = maps.truth
    return ChannelRecord(float(problem.observation.freqs[f]), summary, arrays, posterior.log_evidence)
