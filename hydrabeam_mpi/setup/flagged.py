"""Channels of which all data of a polarisation are flagged: found before anything is made of them, and left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.runs import runs_of
from hydrabeam_mpi.io.noise import check_weights
from hydrabeam_mpi.io.uvdata import read_block
from hydrabeam_mpi.io.uvrows import SAMPLE_BYTES, WINDOW_BYTES
from hydrabeam_mpi.io.uvsource import Data
from hydrabeam_mpi.mpi import Comm, allreduce_max, together

FIRST_ROWS = 64
"""Enough to find an unflagged sample in most channels, and quickly read."""
GROWTH = 16
"""By how much more is read at once the longer none is found, as each time the headers are read too."""


def without_flagged(world: Comm, job: Job, files: Sequence[Data], observation: Observation) -> tuple[Job, Observation]:
    """Leave out channels without any unflagged cross-correlation in one polarisation, as if the job did not name them.

    Collective: all ranks of `world`, which share out the times. Most channels have data that count among the first
    that are looked at, and of the others alone all are read.

    Raises
    ------
    InputError
        On all ranks, if a file cannot be read, or no channel is left.
    """
    live = _live_channels(world, files, observation)
    with together(world):
        check_weights(int(live.sum()), int(live.sum()), files)
    if live.all():
        return job, observation
    freqs, scale = observation.freqs[live], job.data.flux_scale
    changes = {
        "freqs": tuple(freqs.tolist()),
        "freq_range": None,
        "channels": None,
        "flux_scale": tuple(np.array(scale)[live].tolist()) if len(scale) == len(live) > 1 else scale,
    }
    kept = replace(
        observation,
        freqs=freqs,
        channel_width=observation.channel_width[live],
        doubts=(*observation.doubts, _told(observation.freqs, live, observation.pols)),
    )
    return job.model_copy(update={"data": job.data.model_copy(update=changes)}), kept


def _live_channels(world: Comm, files: Sequence[Data], observation: Observation) -> BoolArray:
    """Tell which channels have unflagged data in all polarisations, (Nfreqs,)."""
    live = np.zeros((observation.Nfreqs, observation.Npols), dtype=np.int64)
    times = np.array_split(np.arange(observation.Ntimes), world.size)[world.rank]
    rows, at, step = len(times) * observation.Nbls, 0, FIRST_ROWS
    while True:
        dark = np.flatnonzero(~live.all(axis=1))
        with together(world):
            until = min(rows, at + min(step, WINDOW_BYTES // (SAMPLE_BYTES * dark.size * observation.Npols) + 1))
            for part_times, part_bls in _rectangles(times, observation.Nbls, at, until):
                live[dark] |= _have_data(files, observation, dark, part_times, part_bls)
        at, step = until, GROWTH * step
        told = np.append(live, int(at < rows))
        allreduce_max(world, told)
        live = told[:-1].reshape(live.shape)
        if live.all() or not told[-1]:
            return np.asarray(live.all(axis=1))


def _rectangles(times: IntArray, n_bls: int, first: int, last: int) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield times and baselines of rows ``first`` to ``last``, of which those of one time lie together."""
    while first < last:
        time, bl = divmod(first, n_bls)
        whole = (last - first) // n_bls if bl == 0 else 0
        count = whole * n_bls or min(last - first, n_bls - bl)
        yield times[time : time + max(whole, 1)], np.arange(bl, n_bls if whole else bl + count)
        first += count


def _have_data(
    files: Sequence[Data], observation: Observation, channels: IntArray, times: IntArray, bls: IntArray
) -> BoolArray:
    """Tell which of some channels have unflagged data at some times and baselines, (len(channels), Npols)."""
    part = replace(observation, freqs=observation.freqs[channels], channel_width=observation.channel_width[channels])
    flags = read_block(files, part, times, observation.antpairs[bls], observation.pols).flags
    return np.asarray(~flags.all(axis=(1, 2)))


def _told(freqs: FloatArray, live: BoolArray, pols: Sequence[str]) -> str:
    """Say which channels are left out; neighbours are told as ranges."""
    dark = np.flatnonzero(~live)
    named = (" to ".join(f"{freqs[f] / 1e6:.6g}" for f in np.unique(run[[0, -1]])) for run in runs_of(dark))
    data = "all data" if len(pols) == 1 else f"all data of {' or '.join(pols)}"
    return f"Skipped {len(dark)} of {len(live)} channels, of which {data} are flagged: {', '.join(named)} MHz."
