"""From a job file to everything that the inference needs besides the visibilities themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.named import expand
from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.partition import Tile, make_tiles
from hydrabeam_mpi.data.redundancy import RedundantGroups
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.inference.prior import DiagonalPrior, Prior
from hydrabeam_mpi.io.inferred import Inferred
from hydrabeam_mpi.io.noise import amid, difference_variance
from hydrabeam_mpi.io.uvsource import Data
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.model.engines import make_engine
from hydrabeam_mpi.model.engines.base import Precision
from hydrabeam_mpi.model.engines.smearing import smearing_of
from hydrabeam_mpi.model.rime import ForwardModel
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.setup.beams import fit_model_beams, given_priors, load_beams, make_prior, shaped
from hydrabeam_mpi.setup.cautions import cautions_of_basis, cautions_of_data
from hydrabeam_mpi.setup.earlier import beam_priors, find_earlier
from hydrabeam_mpi.setup.findings import Finding
from hydrabeam_mpi.setup.given import NOTHING, Given
from hydrabeam_mpi.setup.over_frequency import Coupling, couple
from hydrabeam_mpi.setup.selected import find_groups, observe, roles_of
from hydrabeam_mpi.setup.skies import count_sources, load_sky, source_positions


@dataclass(frozen=True)
class Problem:
    """A job made concrete. Built on one rank, shared by all, and cut down to a rank group's channels.

    Attributes
    ----------
    job : Job
    files : tuple of Path or Source
        The visibilities.
    gain_files : tuple of Path
    observation : Observation
    redundant : RedundantGroups
        Of the observation's baselines.
    train, test : Tile
        Rows to infer from and rows held out.
    sky : Sky
        The sky model at the observation's channels.
    flux_removed : float
        Fraction of the sky's flux that the model leaves out.
    basis : LinearBasis
    beams : tuple of callable
        The model beam of each channel, before the inference.
    priors : tuple of Prior
        On the coefficients of each channel.
    fit_rms : tuple of float
        Root mean square of model beam minus its fit in the basis, each channel.
    time_costs : ndarray, (Ntimes,)
        To balance ranks: sources above the horizon.
    truths : tuple of callable
        The beams that the data were simulated with; empty for measured data.
    noise_variance : ndarray, (Nfreqs, Nbls, Npols), optional
        Of one sample, where the noise is estimated from differences.
    channel_numbers : ndarray of int, (Nfreqs,)
        Which of the job's channels these are.
    cautions : tuple of str
        What a user should not overlook about the data.
    noise_file : Path or Source, optional
        Where the noise is from, if from a file.
    findings : tuple of Finding
        What was found wrong with the data before anything was fitted.
    earlier : Inferred, optional
        The result that is the prior, of all the job's channels. ``priors`` have its effects marginalised.
    coupling : Coupling, optional
        How the beams of all the job's channels hang together, where they do.
    """

    job: Job
    files: tuple[Data, ...]
    gain_files: tuple[Path, ...]
    observation: Observation
    redundant: RedundantGroups
    train: Tile
    test: Tile
    sky: Sky
    flux_removed: float
    basis: LinearBasis
    beams: tuple[Beam, ...]
    priors: tuple[Prior, ...]
    fit_rms: tuple[float, ...]
    time_costs: FloatArray
    channel_numbers: IntArray
    truths: tuple[Beam, ...] = ()
    noise_variance: FloatArray | None = None
    cautions: tuple[str, ...] = ()
    noise_file: Data | None = None
    findings: tuple[Finding, ...] = ()
    earlier: Inferred | None = None
    coupling: Coupling | None = None

    @property
    def model_means(self) -> tuple[Array, ...]:
        """Coefficients of each channel's model beam, to which effects refer, (n_modes,) each."""
        if self.earlier is None:
            return tuple(prior.mean for prior in self.priors)
        return tuple(self.earlier.model_means[number] for number in self.channel_numbers.tolist())

    @property
    def flux_scale(self) -> FloatArray:
        """What data are multiplied by, (Nfreqs,)."""
        scale = np.array(self.job.data.flux_scale)
        return scale[self.channel_numbers] if len(scale) > 1 else np.full(len(self.channel_numbers), scale[0])

    def of_channels(self, channels: Sequence[int]) -> Problem:
        """Keep some channels."""
        index = np.array(channels, dtype=int)

        def chosen(items: tuple[Any, ...]) -> tuple[Any, ...]:
            return tuple(items[i] for i in channels) if items else ()

        return replace(
            self,
            observation=replace(
                self.observation,
                freqs=self.observation.freqs[index],
                channel_width=self.observation.channel_width[index],
            ),
            sky=self.sky.channels(index),
            beams=chosen(self.beams),
            priors=chosen(self.priors),
            fit_rms=chosen(self.fit_rms),
            truths=chosen(self.truths),
            noise_variance=None if self.noise_variance is None else self.noise_variance[index],
            channel_numbers=self.channel_numbers[index],
        )

    def with_prior_widths(self, widths: PriorWidths | None) -> Problem:
        """Return the same with other widths of the beams' priors, which have to be adaptable; None: as they are."""
        if widths is None:
            return self
        return replace(self, priors=tuple(cast(DiagonalPrior, prior).adapted(widths) for prior in self.priors))

    @property
    def has_adaptable_widths(self) -> bool:
        """Whether the beams' priors are of independent coefficients, whose widths the job states, in each channel."""
        known = [isinstance(prior, DiagonalPrior) and prior.sizes is not None for prior in self.priors]
        return all(known) and self.coupling is None

    def with_shape(self, comm: Comm) -> Problem:
        """Return the same with beams that may differ from their models as a whole, as its job then states.

        Where their prior is one that the data adapt, and the job does not state otherwise. The problem has all of the
        job's channels. Collective: all ranks of `comm`.
        """
        settings = self.job.prior
        is_stated = settings.widths == "stated" or settings.shape is not None
        if is_stated or settings.has_shape or not self.has_adaptable_widths:
            return self
        numbers = range(comm.rank, len(self.priors), comm.size)
        with together(comm):
            mine = shaped([self.priors[f] for f in numbers], [self.beams[f] for f in numbers], self.basis)
        found = {f: one for part in comm.allgather(dict(zip(numbers, mine, strict=True))) for f, one in part.items()}
        job = self.job.model_copy(update={"prior": settings.model_copy(update={"shape": True})})
        return replace(self, job=job, priors=tuple(found[f] for f in sorted(found)))

    def tile_of(self, rows: Tile, rank: int, size: int, whole_times: bool = False) -> Tile:
        """Return a rank's share of some rows, among ``size`` ranks; ``whole_times`` keeps those of a time together."""
        costs, group = self.time_costs[rows.times], self.redundant.group[rows.bls]
        if whole_times:
            group = np.zeros_like(group)
        return make_tiles(rows.times, costs, rows.bls, group, size)[rank]

    @property
    def n_unique_baselines(self) -> int:
        """Number of different baseline vectors."""
        return self.redundant.Ngroups

    def forward_model(self, groups: IntArray, precision: Precision = np.float64) -> ForwardModel:
        """Return the forward model of some redundant ``groups``, (Ngroups,)."""
        job = self.job
        observation, vectors = self.observation, self.redundant.vectors[groups]
        engine = make_engine(job.solver.engine, vectors, observation.antpos, smearing_of(observation))
        positions = source_positions(job, self.sky, observation)
        return ForwardModel(positions, self.sky.flux, observation.freqs, engine, precision)


def prepare(
    job: Job,
    files: tuple[Data, ...],
    truths: tuple[Beam, ...] = (),
    given: Given = NOTHING,
    observation: Observation | None = None,
) -> Problem:
    """Read and fit everything but the visibilities. Serial.

    Parameters
    ----------
    job : Job
    files : tuple of Path or Source
        The visibilities.
    truths : tuple of callable
        The beams that they were simulated with, where they were.
    given : Given
        What is in memory: beam, sky, noise and priors; the visibilities are all in ``files``.
    observation : Observation, optional
        What `observe` says of the files, where it is known already.

    Raises
    ------
    InputError
        If a file or a setting cannot be used.
    """
    observation = observation or observe(job, files)
    if how := _differences(job):
        amid(observation, how)
    train, test = roles_of(job, observation)
    # Before the sky, which takes longer: a channel out of the beam's range ends the run here.
    beams = load_beams(job, observation.freqs, observation.pols[0], given.beam)
    whole_sky = load_sky(job, observation, given.sky)
    sky = whole_sky.brighter_than(job.sky.model_flux_min)
    time_costs = count_sources(sky, observation)
    earlier = find_earlier(job, observation, given.earlier)
    return Problem(
        job=job,
        files=files,
        gain_files=expand(job.data.gains, "[data] gains", "file"),
        observation=observation,
        redundant=find_groups(job, observation),
        train=train,
        test=test,
        sky=sky,
        flux_removed=1 - float(sky.flux.sum() / whole_sky.flux.sum()),
        time_costs=time_costs,
        channel_numbers=np.arange(observation.Nfreqs),
        truths=truths,
        noise_file=given.noise or job.noise.file,
        earlier=earlier,
        **_known_of_beams(job, observation, beams, earlier, given),
    )


def _known_of_beams(
    job: Job, observation: Observation, beams: tuple[Beam, ...], earlier: Inferred | None, given: Given
) -> dict[str, Any]:
    """Return the fields of a `Problem` that follow from the model beams, (Nfreqs,), and what is known of them."""
    basis, fits = fit_model_beams(job, beams, earlier.basis if earlier else None)
    if earlier is not None:
        priors: tuple[Prior, ...] = beam_priors(earlier)
    else:
        priors = given_priors(given.priors, fits) if given.priors else tuple(make_prior(job, fit) for fit in fits)
        if job.prior.has_shape and not given.priors:
            priors = shaped(priors, beams, basis)
    is_made = earlier is None and not given.priors
    return {
        "basis": basis,
        "beams": beams,
        "priors": priors,
        "fit_rms": tuple(fit.rms_residual for fit in fits),
        "cautions": (
            *cautions_of_data(job, observation),
            *(cautions_of_basis(job, fits[len(fits) // 2]) if is_made else ()),
        ),
        "coupling": couple(job.prior.frequency, observation.freqs, priors),
    }


def of_polarization(problem: Problem, job: Job, pol: str, truths: tuple[Beam, ...], given: Given) -> Problem:
    """Return the problem of a job that differs in its polarisation alone, ``pol`` as the data name it. Serial.

    Other parameters and errors as of `prepare`.
    """
    observation = replace(problem.observation, pols=(pol,))
    beams = load_beams(job, observation.freqs, pol, given.beam)
    known = _known_of_beams(job, observation, beams, None, given)
    # Cross-polarised visibilities of a baseline and of its reverse are no conjugates.
    as_before = observation.is_copolar == problem.observation.is_copolar
    redundant = problem.redundant if as_before else find_groups(job, observation)
    return replace(problem, job=job, observation=observation, redundant=redundant, truths=truths, **known)


def _differences(job: Job) -> Literal["time", "frequency"] | None:
    """Return between which neighbours the noise is estimated, if it is."""
    match job.noise.kind:
        case "time-differences":
            return "time"
        case "frequency-differences":
            return "frequency"
    return None


def estimate_noise(world: Comm, problem: Problem) -> Problem:
    """Estimate the noise from differences of the data, where the job says so.

    Collective: all ranks of `world`, which share out the baselines.
    """
    how = _differences(problem.job)
    if how is None:
        return problem
    observation = problem.observation
    mine = np.array_split(np.arange(observation.Nbls), world.size)[world.rank]
    with together(world):
        part = difference_variance(problem.files, observation, mine, how, problem.gain_files)
    return replace(problem, noise_variance=np.concatenate(world.allgather(part), axis=1))


def select_anew(problem: Problem, job: Job) -> Problem:
    """Return the problem of a job that differs only in what it selects of the data, or in their scale. Serial."""
    observation = observe(job, problem.files)
    train, test = roles_of(job, observation)
    redundant = find_groups(job, observation)
    return replace(problem, job=job, observation=observation, redundant=redundant, train=train, test=test)
