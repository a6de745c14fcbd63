"""Data without the instrument's effects: what `hydrabeam correct` and `correct` share."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.api.applied import apply_result, read_if_named, say_carried, setup_for, summary_of
from hydrabeam_mpi.api.corrected import Add, Correction, in_files
from hydrabeam_mpi.api.flagged import flagged_told, left_out_here
from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import begun, origin_of
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.left_out import LeftOut, are_left_out
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.taken_out import Parts, of_instrument, take_out
from hydrabeam_mpi.io.noise import calibrated_autos
from hydrabeam_mpi.io.uvdata import read_autos, read_visibilities
from hydrabeam_mpi.io.uvsource import as_source
from hydrabeam_mpi.mpi import allreduce_sum, gather_objects, together
from hydrabeam_mpi.setup.problem import Problem

BLOCK_BYTES = 2**26
"""Rank 0 gathers and writes so many bytes of visibilities at once: far more than a disk's block, far less than nodes
have."""
SAMPLE_BYTES = 4 * 16 + 1 + 8
"""Four kinds of a visibility, its flag and its nsamples."""


def correct(result: Result | str | Path, setup: Setup, bad_antennas: Collection[int] = ()) -> Correction:
    """Take the instrument's effects that a result found out of data.

    The gains and what is added are those of the effects, beside what the setup itself names: gain files and flux scale
    are applied first, as in an inference. Effects of the sky, and a beam of more modes, are part of the model.

    Collective: all ranks of the setup's communicator.

    Parameters
    ----------
    result : Result, str or Path
        Of `infer`, `close_loop` or `load`, or its folder; what rank 0 has counts.
    setup : Setup
        Its channels must be among those of the result, and its polarisation that one.
    bad_antennas : collection of int
        Numbers of antennas whose baselines, autocorrelations and gains are flagged.

    Returns
    -------
    Correction

    Raises
    ------
    InputError
        On all ranks, if the result cannot be applied to these data.
    """
    result = read_if_named(setup.comm, result)
    setup = setup_for(result, setup)
    with begun(setup) as (folder, threads):
        return run_correction(result, setup, folder, threads, bad_antennas)


class _Part(NamedTuple):
    """What a rank has of all rows: where, (channels, times, baselines), and what; gains of all antennas.

    ``unknown`` are those that are not told; see `TakenOut`.
    """

    where: tuple[Any, ...]
    parts: Parts
    flags: NDArray[np.bool_]
    nsamples: FloatArray
    gains: ComplexArray
    unknown: NDArray[np.bool_]


def run_correction(
    result: Result,
    setup: Setup,
    folder: Path | None,
    threads: int,
    bad_antennas: Collection[int] = (),
    into: Path | None = None,
) -> Correction:
    """Take effects out of data. Collective: all ranks of the setup.

    Parameters
    ----------
    result : Result
    setup : Setup
        By `setup_for`.
    folder : Path, optional
        For simulated data.
    threads : int
        BLAS threads of this rank, for the record.
    bad_antennas : collection of int
    into : Path, optional
        Where visibilities and gains are written, some times at once; the correction that is returned does not have
        them then.
    """
    clock, world = Clock(), setup.comm
    problem, context, fitted, carried = apply_result(result, setup, folder, clock)
    left = left_out_here(world, problem, result, context)
    if left:
        carried = replace(carried, left=tuple(one for one in carried.left if one["effect"] not in left.titles))
    say_carried(world, carried)
    with together(world):
        mine, lost = _take_out(context, fitted, left)
    allreduce_sum(world, lost)
    correction, parts, gains = Correction(setup.job), _InMemory(), []
    with ExitStack() as stack:
        add: Add = parts.add
        with together(world):
            if world.rank == 0:
                titles = [one.effect.title for one in of_instrument(context.setup, fitted.values)]
                correction = Correction(
                    setup.job,
                    summary_of(result, problem, carried, {"taken_out": list(dict.fromkeys(titles))}),
                    origin_of(setup, problem, threads),
                    observation=problem.observation,
                    bad_antennas=frozenset(bad_antennas),
                    data_history=_history_of(problem),
                )
                if into is not None:
                    add = stack.enter_context(in_files(correction, into, problem.observation, _has_autos(problem)))
        for times in _blocks(problem.observation):
            gathered = gather_objects(world, _at(mine, times))
            with together(world):
                if gathered is not None:
                    part = _joined(problem, gathered, times, correction)
                    gains.append((part.gains, part.gain_flags))
                    add(times, part)
        with together(world):
            stack.close()  # what is written last, and the files' renaming, may fail
            if world.rank == 0:
                of_all, flags = (np.concatenate(one, axis=1) for one in zip(*gains, strict=True))
                told = flagged_told(problem.observation, flags, correction.bad_antennas, left, lost)
                summary = {**correction.summary, "flagged": told}
                correction = replace(correction, gains=of_all, gain_flags=flags, summary=summary)
            if world.rank == 0 and into is not None:
                correction.write_gains(into, problem.observation)
    if world.rank or into is not None:
        return replace(correction, observation=None)
    return parts.joined(correction)


def _take_out(context: FitContext, fitted: Fitted, left: LeftOut | None) -> tuple[_Part, IntArray]:
    """Return what a rank has, and how many of its rows of each time are left out, of how many, (2, Ntimes). Serial."""
    problem, tile = context.problem, context.test.rows.tile
    _, flags, nsamples = read_visibilities(problem.files, problem.observation, tile)
    parts, usable, gains, unknown = take_out(context, fitted)
    lost, counts = np.zeros_like(usable), np.zeros((2, problem.observation.Ntimes), dtype=int)
    if left:
        lost = are_left_out(context, fitted, left)
        counts[:, tile.times] = lost.sum(axis=(0, 2)), usable[..., left.place[tile.bls] >= 0].sum(axis=(0, 2))
    # Channels are numbered as the group's are in the data, whatever their numbers in the result.
    where = (list(context.grid.channels), tile.times, tile.bls)
    flagged = flags[..., 0] | ~usable | lost
    return _Part(where, parts, flagged, nsamples[..., 0], gains, unknown), counts


def _has_autos(problem: Problem) -> bool:
    """Tell whether any of the files has autocorrelations."""
    antpairs = (as_source(one).metadata()[1].antpairs for one in problem.files)
    return any(np.any(pairs[:, 0] == pairs[:, 1]) for pairs in antpairs)


def _history_of(problem: Problem) -> str:
    """Return what the files say of themselves, each word of it once."""
    return "\n".join(dict.fromkeys(as_source(one).metadata()[0].history.rstrip("\n") for one in problem.files))


def _blocks(observation: Observation) -> list[IntArray]:
    """Split all times into such as are gathered and written at once."""
    n_bytes = observation.Ntimes * observation.Nfreqs * observation.Nbls * SAMPLE_BYTES
    n_blocks = min(-(-n_bytes // BLOCK_BYTES), observation.Ntimes)
    return [np.asarray(times) for times in np.array_split(np.arange(observation.Ntimes), n_blocks)]


def _at(mine: _Part, times: IntArray) -> _Part:
    """Return what a rank has of some times, which are numbered from the first of them."""
    channels, own, bls = mine.where
    here = np.isin(own, times)
    parts = Parts(*(one[:, here] for one in mine.parts))
    return _Part(
        (channels, own[here] - times[0], bls),
        parts,
        mine.flags[:, here],
        mine.nsamples[:, here],
        mine.gains[:, here],
        mine.unknown[:, here],
    )


def _joined(problem: Problem, gathered: list[_Part], times: IntArray, correction: Correction) -> Correction:
    """Put together what all ranks have of some times. Serial."""
    observation = problem.observation
    shape = (observation.Nfreqs, len(times), observation.Nbls, 1)
    visibilities = {name: np.zeros(shape, dtype=complex) for name in Parts._fields}
    flags, nsamples = np.ones(shape, dtype=bool), np.zeros(shape)
    gains = np.ones((*shape[:2], observation.Nants), dtype=complex)
    bad = np.isin(observation.antenna_numbers, list(correction.bad_antennas))
    gain_flags = np.broadcast_to(bad, gains.shape).copy()
    for one in gathered:
        at_times = np.ix_(*one.where[:2])
        gains[at_times] = one.gains
        gain_flags[at_times] |= one.unknown
        index = (*np.ix_(*one.where), 0)
        flags[index], nsamples[index] = one.flags, one.nsamples
        for name, values in one.parts._asdict().items():
            visibilities[name][index] = np.where(one.flags, 0.0, values)
    flags[..., 0] |= np.any(gain_flags[:, :, observation.antenna_index], axis=3)
    for values in visibilities.values():
        values[flags] = 0.0
    autos = calibrated_autos(read_autos(problem.files, observation, times), observation, times, problem.gain_files)
    autos.data[gain_flags], autos.flags[gain_flags] = 0.0, True
    power = autos.power * problem.flux_scale.reshape(-1, 1, 1, 1) / np.abs(gains[..., np.newaxis]) ** 2
    return Correction(
        problem.job,
        visibilities=visibilities,
        flags=flags,
        nsamples=nsamples,
        autos=power,
        auto_flags=autos.flags,
        auto_nsamples=autos.nsamples,
        gains=gains,
        gain_flags=gain_flags,
    )


class _InMemory:
    """Keeps some times after the other."""

    def __init__(self) -> None:
        self._parts: list[Correction] = []

    def add(self, times: IntArray, part: Correction) -> None:
        """Take the next times."""
        self._parts.append(part)

    def joined(self, correction: Correction) -> Correction:
        """Return the correction with all times."""

        def whole(name: str) -> Any:
            return np.concatenate([getattr(one, name) for one in self._parts], axis=1)

        names = Parts._fields
        visibilities = {name: np.concatenate([one.visibilities[name] for one in self._parts], axis=1) for name in names}
        arrays = {name: whole(name) for name in ("flags", "nsamples", "autos", "auto_flags", "auto_nsamples")}
        return replace(correction, visibilities=visibilities, **arrays)
