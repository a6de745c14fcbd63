"""Data without the instrument's effects: what `hydrabeam correct` and `correct` share."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.api.applied import Applied, apply_result, setup_for, summary_of
from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import begun, origin_of
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, Observation
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.taken_out import Parts, antenna_gains, take_out
from hydrabeam_mpi.io.calfits import write_calfits
from hydrabeam_mpi.io.noise import calibrated_autos
from hydrabeam_mpi.io.uvdata import read_visibilities
from hydrabeam_mpi.io.uvwrite import write_uvh5
from hydrabeam_mpi.mpi import gather_objects, together
from hydrabeam_mpi.setup.problem import Problem

WHAT = {
    "corrected": "Visibilities without the instrument's effects: (V / (g_i g_j*) - added).",
    "model": "The sky as the inferred beam sees it: corrected visibilities without residual.",
    "residual": "Corrected visibilities minus their model.",
    "added": "What effects had added to the visibilities before the gains multiplied them.",
}
"""The files of visibilities, and their histories."""


@dataclass(frozen=True)
class Correction(Applied):
    """Data, and what of them is the instrument's: V = g_i g_j* (corrected + added), corrected = model + residual.

    On ranks other than 0 there is nothing in it but the job.

    Attributes
    ----------
    job : Job
        The data.
    observation : Observation, optional
    visibilities : dict
        ``corrected``, ``model``, ``residual`` and ``added``, each (Nfreqs, Ntimes, Nbls, 1), Jy, in the convention
        V = 1/2 I B; zero where flagged.
    flags, nsamples : ndarray, same shape
    autos : ndarray, (Nfreqs, Ntimes, Nants, Nfeeds)
        Corrected autocorrelations, Jy; NaN where there are none.
    gains : ndarray of complex, (Nfreqs, Ntimes, Nants)
    summary : dict
        What ``correction.json`` says: which effects hold in these data, and warnings.
    about : dict
        Where it comes from.
    """

    told_in = "correction.json"
    observation: Observation | None = None
    visibilities: dict[str, ComplexArray] = field(default_factory=dict)
    flags: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    nsamples: FloatArray = field(default_factory=lambda: np.zeros(0))
    autos: FloatArray = field(default_factory=lambda: np.zeros(0))
    gains: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))

    def write_data(self, folder: Path) -> None:
        """Write visibilities and gains."""
        assert self.observation is not None
        by = f"hydrabeam_mpi {self.about['versions']['hydrabeam_mpi']}, result {self.summary['result']}."
        for name, values in self.visibilities.items():
            autos = self.autos if name == "corrected" and np.isfinite(self.autos).any() else None
            path, history = folder / f"{name}.uvh5", f"{WHAT[name]} Written by {by}"
            write_uvh5(path, self.observation, values, self.flags, self.nsamples, autos, history)
        given = ", ".join(map(str, self.job.data.gains))
        relative = f"Relative to those of {given}, by which the data were divided before." if given else "Total."
        history = f"Gains that effects stand for. {relative} Written by {by}"
        write_calfits(folder / "gains.calfits", self.observation, self.gains, history)


def correct(result: Result, setup: Setup, bad_antennas: Collection[int] = ()) -> Correction:
    """Take the instrument's effects that a result found out of data.

    The gains and what is added are those of the effects, beside what the setup itself names: gain files and flux scale
    are applied first, as in an inference. Effects of the sky, and a beam of more modes, are part of the model.

    Collective: all ranks of the setup's communicator.

    Parameters
    ----------
    result : Result
        Of `infer`, `close_loop` or `load`; what rank 0 has counts.
    setup : Setup
        Its channels must be among those of the result, and its polarisation that one.
    bad_antennas : collection of int
        Numbers of antennas whose baselines are flagged.

    Returns
    -------
    Correction

    Raises
    ------
    InputError
        On all ranks, if the result cannot be applied to these data.
    """
    setup = setup_for(result, setup)
    with begun(setup) as (folder, threads):
        return run_correction(result, setup, folder, threads, bad_antennas)


class _Part(NamedTuple):
    """What a rank has of all rows: where, (channels, times, baselines), and what."""

    where: tuple[Any, ...]
    parts: Parts
    flags: NDArray[np.bool_]
    nsamples: FloatArray


def run_correction(
    result: Result, setup: Setup, folder: Path | None, threads: int, bad_antennas: Collection[int] = ()
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
    """
    clock, world = Clock(), setup.comm
    problem, context, fitted, carried = apply_result(result, setup, folder, clock)
    with together(world):
        mine = _take_out(context, fitted)
    gathered = gather_objects(world, mine)
    correction = Correction(setup.job)
    with together(world):
        if gathered is not None:
            gains = antenna_gains(context.setup, fitted.values)[problem.channel_numbers]
            summary, about = summary_of(result, problem, carried), origin_of(setup, problem, threads)
            correction = _joined(problem, gathered, gains, bad_antennas)
            correction = replace(correction, job=setup.job, summary=summary, about=about)
    return correction


def _take_out(context: FitContext, fitted: Fitted) -> _Part:
    """Return what a rank has. Serial."""
    problem, tile = context.problem, context.test.rows.tile
    _, flags, nsamples = read_visibilities(problem.files, problem.observation, tile)
    parts, usable = take_out(context, fitted)
    # Channels are numbered as the group's are in the data, whatever their numbers in the result.
    where = (list(context.grid.channels), tile.times, tile.bls)
    return _Part(where, parts, flags[..., 0] | ~usable, nsamples[..., 0])


def _joined(problem: Problem, gathered: list[_Part], gains: ComplexArray, bad_antennas: Collection[int]) -> Correction:
    """Put together what all ranks have. Serial."""
    observation = problem.observation
    shape = (observation.Nfreqs, observation.Ntimes, observation.Nbls, 1)
    visibilities = {name: np.zeros(shape, dtype=complex) for name in Parts._fields}
    flags, nsamples = np.ones(shape, dtype=bool), np.zeros(shape)
    for one in gathered:
        index = (*np.ix_(*one.where), 0)
        flags[index], nsamples[index] = one.flags, one.nsamples
        for name, values in one.parts._asdict().items():
            visibilities[name][index] = np.where(one.flags, 0.0, values)
    flags[:, :, np.isin(observation.antpairs, list(bad_antennas)).any(axis=1)] = True
    for values in visibilities.values():
        values[flags] = 0.0
    times = np.arange(observation.Ntimes)
    autos = calibrated_autos(problem.files, observation, times, problem.gain_files)
    autos = autos * problem.flux_scale.reshape(-1, 1, 1, 1) / np.abs(gains[..., np.newaxis]) ** 2
    return Correction(
        job=problem.job,
        observation=observation,
        visibilities=visibilities,
        flags=flags,
        nsamples=nsamples,
        autos=autos,
        gains=gains,
    )
