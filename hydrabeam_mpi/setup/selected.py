"""What a job takes of the data: which rows, in which role, and which of them are redundant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.redundancy import RedundantGroups, check_tolerance, find_redundant_groups
from hydrabeam_mpi.data.selection import HoldoutRule, Selection, split_holdout
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvmeta import read_observation
from hydrabeam_mpi.io.uvsource import Data
from hydrabeam_mpi.model.engines.smearing import smearing_of


def select(job: Job) -> Selection:
    """Turn the data section into a selection in radians and Hz."""
    data = job.data
    return Selection(
        pols=data.polarization,
        antennas=data.antennas,
        exclude_antennas=data.exclude_antennas,
        antpairs=data.antpairs,
        min_bl_length=data.min_bl_length or None,
        max_bl_length=data.max_bl_length,
        channels=data.channels,
        freqs=data.freqs,
        freq_range=data.freq_range,
        time_range=data.time_range,
        lst_range=None if data.lst_range is None else _radians(data.lst_range),
        every_time=data.every_time,
    )


def _radians(hours: tuple[float, float]) -> tuple[float, float]:
    return hours[0] * np.pi / 12, hours[1] * np.pi / 12


def observe(job: Job, files: tuple[Data, ...]) -> Observation:
    """Read what was observed, and take of it what the job selects and corrects."""
    observation = read_observation(files, select(job))
    known = set(observation.antpairs.ravel().tolist())
    if unknown := {ant for pair in job.data.exclude_baselines for ant in pair} - known:
        listed = ", ".join(map(str, sorted(unknown)))
        field = "[data] exclude_baselines"
        raise InputError(f"antenna {listed} is not in the data", field=field, remedy="remove it from the list")
    _check_scale(job, observation)
    width = job.data.channel_width
    observation = replace(
        observation,
        pol_convention=job.data.pol_convention,
        is_smeared=job.data.smearing,
        exclude_times=job.data.exclude_times,
        exclude_baselines=job.data.exclude_baselines,
        channel_width=observation.channel_width if width is None else np.full(observation.Nfreqs, width),
    )
    smearing_of(observation)
    return observation


def _check_scale(job: Job, observation: Observation) -> None:
    """Make sure that flux scales by channel are of these channels."""
    n = len(job.data.flux_scale)
    if n not in (1, observation.Nfreqs):
        raise InputError(
            f"has {n} numbers, and there are {observation.Nfreqs} channels",
            field="[data] flux_scale",
            remedy="give one number for all channels, or a list with one for each",
        )


def _holdout_rule(job: Job) -> HoldoutRule:
    """Turn the hold-out section into a rule in radians."""
    holdout = job.holdout
    return HoldoutRule(
        kind=holdout.kind,
        every=holdout.every,
        lst_ranges=tuple(_radians(lst_range) for lst_range in holdout.lst_ranges),
        jd_ranges=holdout.jd_ranges,
        antpairs=holdout.antpairs,
    )


def roles_of(job: Job, observation: Observation) -> tuple[Tile, Tile]:
    """Return the rows to infer from and those held out."""
    split = split_holdout(observation, _holdout_rule(job))
    train = Tile(np.flatnonzero(split.train_times), np.flatnonzero(split.train_bls))
    return train, Tile(np.flatnonzero(split.test_times), np.flatnonzero(split.test_bls))


def find_groups(job: Job, observation: Observation) -> RedundantGroups:
    """Group redundant baselines, or keep each alone where the job says not to compress."""
    tol, vectors = job.data.redundancy_tol, observation.bl_vectors
    redundant = find_redundant_groups(vectors, tol, either_sign=observation.is_copolar)
    if job.solver.compress:
        check_tolerance(observation, redundant, tol)
        return redundant
    signs = np.where(redundant.flipped, -1.0, 1.0)[:, np.newaxis]
    return RedundantGroups(signs * vectors, np.arange(observation.Nbls), redundant.flipped)
