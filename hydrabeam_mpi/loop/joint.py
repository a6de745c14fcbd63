"""From the effects of a job to a joint fit, and from that to what `infer` writes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.accumulate import accumulate_designs, check_designs
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.effects.catalogue import EFFECTS, REWEIGHTINGS, make_effect
from hydrabeam_mpi.effects.scene import Experiment
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.infer.posterior import Posterior
from hydrabeam_mpi.inference import ChannelResult, Clock, read_shares, reduce_heldout, reduce_normals
from hydrabeam_mpi.io.uvmeta import read_observation
from hydrabeam_mpi.loop.refit import Space, refit
from hydrabeam_mpi.loop.state import Active, Reweighted, State
from hydrabeam_mpi.loop.workspace import Share
from hydrabeam_mpi.mpi import ProcessGrid, together
from hydrabeam_mpi.problem import Problem


def find_experiment(problem: Problem) -> Experiment:
    """Return what effects may know before any visibility is read. Serial."""
    return Experiment(
        observation=problem.observation,
        redundant=problem.redundant,
        sky=problem.sky,
        basis=problem.basis,
        prior_mean=tuple(prior.mean for prior in problem.priors),
        file_pols=read_observation(problem.files, Selection()).pols,
        times=np.union1d(problem.train.times, problem.test.times),
    )


def read_space(grid: ProcessGrid, problem: Problem, experiment: Experiment, clock: Clock) -> Space:
    """Read the rank's rows. Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the rank group's channels.
    experiment : Experiment
        Of all channels.
    clock : Clock
        Receives the phase "read".
    """
    with clock.time("read"):
        train, test = read_shares(grid, problem)
    return Space(grid, problem, experiment, Share(problem, experiment, train), Share(problem, experiment, test))


def restore(job: Job, experiment: Experiment) -> State:
    """Return the state that a job's ``[[effects]]`` describe, not yet fitted.

    Raises
    ------
    InputError
        If an effect does not fit the data.
    """
    state = State()
    n_freqs = experiment.observation.Nfreqs
    for number, entry in enumerate(job.effects):
        field = f"[[effects]] number {number + 1} ({entry.kind})"
        if len(entry.values) != n_freqs:
            raise InputError(
                f"has values for {len(entry.values)} channels, the data have {n_freqs}",
                field=field,
                remedy="use the job as 'hydrabeam loop' wrote it, with the same channels",
            )
        if entry.kind in REWEIGHTINGS:
            values = np.array(entry.values)
            state.reweighted.append(Reweighted(REWEIGHTINGS[entry.kind](), values, np.array(entry.std)))
            continue
        if entry.kind not in EFFECTS:
            raise InputError("cannot be part of the model", field=field, remedy="remove it")
        effect = make_effect(entry.kind, entry.settings)
        parameters = effect.parameters(experiment)
        index = np.array(entry.index, dtype=int)
        if [parameters.names[i] for i in index if i < len(parameters)] != list(entry.names):
            raise InputError(
                "is about other antennas, times or sources than the data have",
                field=field,
                remedy="use the job as 'hydrabeam loop' wrote it, with the same data, or run the loop again",
            )
        prior_var, x = np.zeros(len(parameters)), np.zeros((n_freqs, len(parameters)))
        prior_var[index], x[:, index] = np.square(entry.prior_std), np.array(entry.values)
        state.active.append(replace(Active.start(effect, experiment, prior_var, x), prior_var=prior_var))
    return state


def infer_jointly(space: Space, clock: Clock) -> tuple[State, list[ChannelResult]]:
    """Fit beams and the job's effects jointly. Collective: all ranks of the grid."""
    with together(space.grid.world):
        state = restore(space.problem.job, space.experiment)
    with clock.time("design"):
        state = refit(space, state)
    with clock.time("solve"):
        pass  # part of every step of the fit
    with clock.time("heldout"):
        return state, channel_results(space, state)


def channel_results(space: Space, state: State) -> list[ChannelResult]:
    """Return what was inferred of each channel of the rank group, the effects' uncertainty included.

    Collective: all ranks of the grid.
    """
    grid, problem = space.grid, space.problem
    with together(grid.world):
        train, _ = space.train.calibrated(state)
        normals = accumulate_designs(train, space.train.designs(state), problem.basis)
    normals = reduce_normals(grid, normals)
    posteriors = _marginal(state)
    with together(grid.world):
        test, _ = space.test.calibrated(state)
        before = space.test.model.visibilities(problem.beams, test.tile.times)
        heldout = check_designs(test, space.test.designs(state), posteriors, before)
    reduce_heldout(grid, heldout)
    return [ChannelResult(*parts) for parts in zip(normals, posteriors, heldout, strict=True)]


def _marginal(state: State) -> Sequence[Posterior]:
    """Return the beams' posteriors with the effects marginalised.

    The beam's covariance grows by M C M^T, with C that of the effects and M by how much the beam follows them. For
    complex coefficients this is the part of it that a circular Gaussian can have.
    """
    if not state.active:
        return state.posteriors
    wider = []
    for posterior, follow, covariance in zip(state.posteriors, state.follows, state.covariances, strict=True):
        values, vectors = np.linalg.eigh(covariance)
        spread = follow @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        # (P^-1 + Z Z^H)^-1 = P - P Z (1 + Z^H P Z)^-1 Z^H P, and P = L L^H.
        half = posterior.factor.conj().T @ spread
        inner = np.linalg.cholesky(np.eye(half.shape[1]) + half.conj().T @ half)
        taken = np.linalg.solve(inner, (posterior.factor @ half).conj().T)
        precision = posterior.factor @ posterior.factor.conj().T - taken.conj().T @ taken
        wider.append(Posterior(posterior.mean, np.linalg.cholesky(precision), posterior.log_evidence))
    return wider
