"""What was observed, as far as figures need it: the array, tracks of sources, and where the held-out sample lies."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.fit.heldout_sample import sampled_rows
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.setup.skies import source_positions

N_TRACKS, N_TRIED, TRACK_TIMES = 8, 200, 61
"""Tracks that are kept, of how many of the brightest sources, at how many times: enough for smooth lines of a few."""


def observed(problem: Problem) -> dict[str, Array]:
    """Return the arrays of the group ``observed`` of ``posterior.h5``. Serial.

    Parameters
    ----------
    problem : Problem
        Of all channels.
    """
    observation, redundant = problem.observation, problem.redundant
    told: dict[str, Array] = {
        "antenna_numbers": observation.antenna_numbers,
        "antenna_positions": observation.antpos,
        "baselines": observation.antpairs,
        "baseline_vectors": redundant.vectors.astype(np.float32),
        "baseline_counts": np.bincount(redundant.group, minlength=redundant.Ngroups),
        **_tracks(problem),
    }
    sample = sampled_rows(observation, problem.test)
    if sample.size:
        told |= {
            "heldout_jd": observation.times[sample.times],
            "heldout_lst": observation.lsts[sample.times],
            "heldout_antennas": observation.antpairs[sample.bls],
        }
    return told


def _tracks(problem: Problem) -> dict[str, Array]:
    """Follow the sources that are the brightest through the model beam of the first channel at any of the times."""
    sky, observation = problem.sky, problem.observation
    brightest = np.argsort(-np.abs(sky.flux[0]), kind="stable")[:N_TRIED]
    positions = source_positions(problem.job, sky, observation).follow(sky.select(brightest))
    times = np.unique(np.linspace(0, observation.Ntimes - 1, TRACK_TIMES).astype(int))
    za, az = np.empty((2, len(brightest), len(times)))
    seen = np.zeros(len(brightest))
    for place, time in enumerate(times.tolist()):
        _, za[:, place], az[:, place] = positions.above_horizon(time, below=np.pi / 2)
        up = za[:, place] < np.pi / 2
        beam = np.abs(problem.beams[0](za[up, place], az[up, place]))
        seen[up] = np.maximum(seen[up], beam * np.abs(sky.flux[0, brightest[up]]))
    chosen = np.argsort(-seen, kind="stable")[:N_TRACKS]
    chosen = chosen[seen[chosen] > 0]
    return {"track_flux": sky.flux[0, brightest[chosen]], "track_za": za[chosen], "track_az": az[chosen]}
