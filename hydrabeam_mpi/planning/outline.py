"""A job made concrete without its visibilities: of files only metadata are read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.frequency import OverFrequency
from hydrabeam_mpi.config.named import expand
from hydrabeam_mpi.data.observation import FloatArray, Observation
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.memory import own_peak_bytes
from hydrabeam_mpi.model.fit import fit_beam
from hydrabeam_mpi.setup.beams import load_beams
from hydrabeam_mpi.setup.given import Given
from hydrabeam_mpi.setup.over_frequency import Coupling, couple
from hydrabeam_mpi.setup.problem import Problem, prepare
from hydrabeam_mpi.setup.selected import observe
from hydrabeam_mpi.setup.skies import load_sky
from hydrabeam_mpi.simulation.mock import check_effects, mock_observation

Clock = Callable[[], float]
"""Tells the time in seconds."""


@dataclass(frozen=True)
class Outline:
    """A job made concrete without its visibilities.

    Attributes
    ----------
    observation : Observation
        Of all channels.
    problem : Problem
        Of one channel, the middle one.
    prepare_s : float
        Seconds of metadata, sky and beams of all channels, with each channel's model fitted to its beam.
    scene_s : float
        Seconds of sky and beams of all channels without these fits, as for a simulation.
    fit_s : float
        Seconds of the fit of one channel.
    peak_bytes : int
        The most memory that all of this took: a catalogue may take many times what is kept of it.
    job : Job
        As it was given; that of the problem has independent channels.
    given : Given
        What is in memory.
    coupling : Coupling, optional
        How the beams of all channels hang together.
    """

    observation: Observation
    problem: Problem
    prepare_s: float
    scene_s: float
    fit_s: float
    peak_bytes: int
    job: Job
    given: Given
    coupling: Coupling | None = None

    @property
    def n_channels(self) -> int:
        """Number of channels."""
        return self.observation.Nfreqs

    @cached_property
    def pair(self) -> Problem | None:
        """The problem of two channels in the middle, by which what is done once a channel is told; None of one."""
        if self.n_channels < 2:
            return None
        two = _middle(self.observation, self.n_channels // 2 - 1)
        return prepare(self.problem.job, (), given=self.given, observation=two)

    def times_of(self, tile: Tile) -> float:
        """Return what the times of a tile cost, in those that have as many visible sources as the mean."""
        return float(np.sum(self.relative_costs[tile.times]))

    @property
    def relative_costs(self) -> FloatArray:
        """Visible sources at each time over their mean, (Ntimes,)."""
        counts = self.problem.time_costs
        return np.asarray(counts / counts.mean())


def outline(job: Job, given: Given, clock: Clock) -> Outline:
    """Make a job concrete. Serial.

    Raises
    ------
    InputError
        If a file or a setting cannot be used.
    """
    start = clock()
    if job.data.simulate is not None and not given.data:
        check_effects(job)
        observation = mock_observation(job.data.simulate, job.data.pol)
    else:
        observation = observe(job, given.data or expand(job.data.files, "[data] files"))
    one = _middle(observation, observation.Nfreqs // 2)
    alone = job.model_copy(update={"prior": job.prior.model_copy(update={"frequency": OverFrequency()})})
    problem = prepare(alone, (), given=given, observation=one)
    coupling = couple(job.prior.frequency, observation.freqs, problem.priors)
    prepared = clock()
    load_sky(job, observation, given.sky)
    load_beams(job, observation.freqs, one.pols[0], given.beam)
    loaded = clock()
    fit_beam(problem.beams[0], problem.basis)
    fit_s, scene_s = clock() - loaded, loaded - prepared
    # A catalogue is read once for all channels.
    prepare_s = max(prepared - start, scene_s + fit_s) + (observation.Nfreqs - 1) * fit_s
    return Outline(observation, problem, prepare_s, scene_s, fit_s, own_peak_bytes(), job, given, coupling)


def _middle(observation: Observation, first: int) -> Observation:
    """Return what is observed in the channels from the ``first`` to the middle one."""
    channels = slice(first, observation.Nfreqs // 2 + 1)
    return replace(observation, freqs=observation.freqs[channels], channel_width=observation.channel_width[channels])
