"""From the effects of a job to a joint fit, and from that to what `infer` writes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.effects import Effect as EffectEntry
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS, make_effect, make_reweighting
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.accumulate import accumulate_designs, check_designs
from hydrabeam_mpi.fit.carried_over import CarriedOver, carry_over, share_fit
from hydrabeam_mpi.fit.channels import ChannelResult, reduce_heldout, reduced_chi2
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.coupled_effects import coupled_channels
from hydrabeam_mpi.fit.coupled_step import check_solved_with_effects
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.grown import beams_alone, marginal_beams
from hydrabeam_mpi.fit.heldout import variance_by_effects
from hydrabeam_mpi.fit.heldout_sample import heldout_sample
from hydrabeam_mpi.fit.learned import Learned
from hydrabeam_mpi.fit.prior_widths import adapted_if_asked
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.room import bytes_to_keep
from hydrabeam_mpi.fit.same_antennas import check_places
from hydrabeam_mpi.fit.settle import settle
from hydrabeam_mpi.fit.shares import read_shares
from hydrabeam_mpi.fit.state import Active, Fitted, Reweighted, Values, independent_prior
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.inference.prior import ChannelPrior, FactoredPrior
from hydrabeam_mpi.io.autos import median_power
from hydrabeam_mpi.io.uvmeta import read_observation
from hydrabeam_mpi.mpi import ProcessGrid, bcast_object, together
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.setup.skies import source_positions
from hydrabeam_mpi.terminal.progress import say

AS_WRITTEN = "use the job as 'hydrabeam loop' wrote it, with the same data, or run the loop again"


def find_setup(problem: Problem) -> ObservingSetup:
    """Return what effects may know before any visibility is read. Serial."""
    return setup_of(problem, read_observation(problem.files, Selection()).pols)


def setup_of(problem: Problem, file_pols: tuple[str, ...]) -> ObservingSetup:
    """Return the same where it is known which polarisations the files have."""
    return ObservingSetup(
        observation=problem.observation,
        redundant=problem.redundant,
        sky=problem.sky,
        basis=problem.basis,
        prior_mean=problem.model_means,
        file_pols=file_pols,
        times=np.union1d(problem.train.times, problem.test.times),
        positions=partial(source_positions, problem.job),
        fitted=problem.train.times,
        model_beam=problem.beams[len(problem.beams) // 2],
    )


def read_context(grid: ProcessGrid, problem: Problem, mine: Problem, clock: Clock) -> FitContext:
    """Read the rank's rows, and find what effects may know of the data. Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem, mine : Problem
        Of all channels, and of the rank group's.
    clock : Clock
        Receives the phases "prepare" and "read".

    Raises
    ------
    InputError
        If the job asks for mixed precision, of which the errors are known for a beam alone; or if beams that hang
        together over frequency cannot be solved for with effects.
    """
    with together(grid.world):
        check_solved_with_effects(problem)
    if problem.job.solver.precision != "double":
        asked = f"'{problem.job.solver.precision}' is for 'hydrabeam infer' without effects"
        raise InputError(asked, field="[solver] precision", remedy="set it to 'double', or leave it out")
    with clock.time("prepare"):
        known = None
        with together(grid.world):
            if grid.is_world_root:
                power = median_power(problem.files, problem.observation)
                known = replace(find_setup(problem), measured_power=power)
        setup = bcast_object(grid.world, known)
        carried, learned = _learn(grid, problem, setup)
    with clock.time("read"):
        # Errors of the predictions of one time are whitened together.
        own, kept_bytes = read_shares(grid, mine, whole_times=True), bytes_to_keep(grid.world)
    train, test = (RankData(mine, setup, rows, kept_bytes=kept_bytes) for rows in own)
    return FitContext(grid, mine, setup, train, test, carried, learned)


def _learn(grid: ProcessGrid, problem: Problem, setup: ObservingSetup) -> tuple[CarriedOver | None, Learned | None]:
    """Return what the result that is the prior says of effects, which is told. Collective: all ranks of the grid."""
    result = problem.earlier
    if result is None or not result.entries:
        return None, None
    shared = None
    with together(grid.world):
        if grid.is_world_root:
            with result.telling():
                shared = carry_over(result.entries, setup)
            check_places(result, shared, problem.observation, problem.job.data.redundancy_tol)
            for line in shared.lines:
                say(line)
    carried: CarriedOver = bcast_object(grid.world, shared)
    if not carried.values.active:
        return carried, None
    beams, covariances, responses = {}, [], {}
    for channel in range(setup.observation.Nfreqs):
        beam, covariance, response = share_fit(grid, result, carried, channel)
        covariances.append(covariance)
        if channel in grid.channels:
            beams[channel], responses[channel] = FactoredPrior(beam.mean, beam.factor), response
    return carried, Learned(carried.values, tuple(covariances), beams, responses)


def restore(job: Job, setup: ObservingSetup, learned: Learned | None = None) -> Values:
    """Return the values of what is ``learned`` and of a job's ``[[effects]]``, not yet fitted.

    Raises
    ------
    InputError
        If an effect does not fit the data.
    """
    active, reweighted = [], []
    n_freqs = setup.observation.Nfreqs
    for number, entry in enumerate(job.effects):
        try:
            if len(entry.values) != n_freqs or len(entry.prior_std) not in (0, 1, n_freqs):
                raise InputError(
                    f"has values for {len(entry.values)} channels, the data have {n_freqs}",
                    remedy="use the job as 'hydrabeam loop' wrote it, with the same channels",
                )
            if entry.kind in REWEIGHTINGS:
                reweighted.append(_restore_reweighting(entry, setup))
            else:
                active.append(_restore_effect(entry, setup))
        except InputError as error:
            error.within(f"[[effects]] number {number + 1} ({entry.kind})")
            raise
    return Values(learned.joined(active) if learned else tuple(active), tuple(reweighted))


def _restore_reweighting(entry: EffectEntry, setup: ObservingSetup) -> Reweighted:
    change, values = make_reweighting(entry.kind, entry.settings), np.array(entry.values)
    if values.shape[1] not in change.sizes(setup) or values.min() <= 0:
        raise InputError("are not what the data need", field="values", remedy=AS_WRITTEN)
    return Reweighted(change, values, np.array(entry.std) if entry.std else np.zeros_like(values))


def _restore_effect(entry: EffectEntry, setup: ObservingSetup) -> Active:
    if entry.kind not in EFFECTS:
        raise InputError("cannot be part of the model", remedy="remove it")
    effect = make_effect(entry.kind, entry.settings)
    not_applicable = effect.not_applicable(setup)
    if not_applicable is not None:
        raise InputError(not_applicable, remedy="remove it")
    parameters = effect.parameters(setup)
    index, known = np.array(entry.index, dtype=int), effect.known_as(parameters.names)
    if [known[name][0] for name in entry.names if name in known] != index.tolist():
        raise InputError("is about other antennas, times or sources than the data have", remedy=AS_WRITTEN)
    prior_var, x = np.zeros((len(entry.prior_std), len(parameters))), np.zeros((len(entry.values), len(parameters)))
    # A baseline may be named the other way round, as by earlier versions.
    sign = np.array([known[name][1] for name in entry.names])
    prior_var[:, index], x[:, index] = np.square(entry.prior_std), sign * np.array(entry.values)
    priors = [independent_prior(of_channel, effect.shared) for of_channel in prior_var]
    prior = ChannelPrior(tuple(one.of(0) for _, one in priors), effect.shared)
    return replace(Active.start(effect, setup, prior_var[0], x), used=priors[0][0], prior=prior)


def fit_with_effects(context: FitContext, clock: Clock) -> Fitted:
    """Fit beams and the job's effects jointly.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    clock : Clock
        Receives the phases "design" and "solve"; each step of the fit solves, so that "design" has all of it.
    """
    with together(context.grid.world):
        values = restore(context.problem.job, context.setup, context.learned)
    with clock.time("design"):
        fitted = settle(context, adapted_if_asked(context, refit(context, values)))
    with clock.time("solve"):
        pass
    return fitted


def channel_results(context: FitContext, fitted: Fitted) -> list[ChannelResult]:
    """Return what was inferred of each channel of the rank group, the effects' uncertainty included.

    Beams are those of `grown_problem`. Collective: all ranks of the grid.
    """
    fitted = with_whole_beams(context, fitted)
    grid, problem, given = context.grid, context.problem, fitted.fit.posteriors
    with together(grid.world):
        train, _ = context.train.calibrated(fitted.estimate)
        normals = accumulate_designs(train, context.train.designs(fitted.values), problem.basis)
    for normal in normals:
        normal.reduce(grid.group)
    with together(grid.world):
        test, added = context.test.calibrated(fitted.estimate)
        before = context.test.model_beam
        variance, with_beam = variance_by_effects(context, fitted, test, added)
        predicting = given if with_beam else beams_alone(fitted.fit)
        designs = context.test.designs(fitted.values)
        # Effects may change the sky, or add functions to the basis.
        models = None if fitted.values.active else problem.model_means
        heldout, after = check_designs(test, designs, predicting, before, variance, context.test.rows, models)
        factor, _ = context.test.effects(fitted.estimate)
    reduce_heldout(grid, heldout)
    samples = heldout_sample(grid, problem, context.test.rows, before, test, after, factor)
    beams = marginal_beams(context.setup, fitted, context.channels, context.learned)
    errors = zip(fitted.fit.covariances, fitted.fit.beam_response, strict=True)
    of_effects = [{"effects_covariance": one, "effects_beam_response": two} for one, two in errors] or [{}] * len(given)
    arrays = [one | two for one, two in zip(of_effects, samples, strict=True)]
    parts = zip(normals, map(reduced_chi2, normals, given), beams, heldout, arrays, strict=True)
    results = [ChannelResult(*part) for part in parts]
    if problem.coupling is None:
        return results
    coupled = coupled_channels(context, fitted)
    return [replace(one, coupled=two) for one, two in zip(results, coupled, strict=True)] if coupled else results
