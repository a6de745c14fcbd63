"""From a job to where its chains walk: what is drawn, the joint fit, and the Gaussian to propose effects from."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.sample import NOISE, PRIOR_WIDTH, Sample, SampledEffect
from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.registry import EFFECTS, make_effect
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.beams_given import solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.coupled_step import marginal_together
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.joint import restore
from hydrabeam_mpi.fit.linearised import linearised, sums_at
from hydrabeam_mpi.fit.prior_widths import with_adapted_prior
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.settle import settle
from hydrabeam_mpi.fit.state import Active, Estimate, Fitted, Values
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import DiagonalPrior
from hydrabeam_mpi.mpi import bcast_array, bcast_object, together
from hydrabeam_mpi.sampling.noise import InverseGamma, NoiseParts
from hydrabeam_mpi.sampling.positive import nowhere_negative
from hydrabeam_mpi.sampling.proposal import Proposal
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.unknowns import Unknowns
from hydrabeam_mpi.sampling.walk import Walk

BEGINS_WIDE = 2.0
"""Chains begin with effects that many times as far from the fit as the posterior is wide, so that it shows in R-hat
whether they have come to the same (Gelman and Rubin 1992)."""

N_REFITS = 3
"""How often the fit is made again with the noise that it leaves; each changes that by a fraction of the time before."""


def begin(context: FitContext) -> Walk:
    """Fit beams and effects of the job jointly, and say from there how chains walk. Collective: the chain's ranks.

    Raises
    ------
    InputError
        On all ranks, if a block cannot be drawn.
    """
    job, wanted = context.problem.job, context.problem.job.sample
    with together(context.grid.world):
        values = _values(context, job)
        moving = _moving(values, wanted)
        group_of = _groups(context, wanted)
        _check_together(context, wanted)
        positive = nowhere_negative(context.problem, wanted.positive_beam) if wanted.positive_beam else None
    context, fitted = with_adapted_prior(context, refit(context, values))
    context, fitted = _with_fixed_weights(context, settle(context, fitted))
    with together(context.grid.world):
        for share in (context.train, context.test) if wanted.heldout else (context.train,):
            share.learn_sky(fitted.values, moving)
    scales = wanted.noise_prior, wanted.width_prior
    noise, widths = (
        InverseGamma(*prior) if block in wanted.blocks else None
        for block, prior in zip((NOISE, PRIOR_WIDTH), scales, strict=True)
    )
    apart = context.learned is None and context.problem.coupling is None
    unknowns = Unknowns(fitted.values, moving, context.setup.observation.Nfreqs, apart)
    with together(context.grid.world):
        unknowns = replace(unknowns, width_of=_width_of(context, unknowns, wanted))
    weighed = context
    for _ in range(0 if noise is None else N_REFITS):
        weighed, fitted = _by_misfit(context, fitted, unknowns.free.shape[1])
    unknowns = replace(unknowns, values=fitted.values)
    proposal = _proposal(weighed, fitted, unknowns)
    parts, tolerance = None, job.data.redundancy_tol
    if noise is not None and wanted.noise_groups != "all":
        parts = NoiseParts.of(wanted.noise_groups, context.setup, tolerance)
    seen_by = fitted.fit.posteriors
    seen = _beam_is_seen(context, unknowns, proposal, seen_by)
    spreads = InverseGamma(*wanted.width_prior) if len(unknowns.width_of) else None
    walk = Walk(context, unknowns, proposal, seen_by, noise, widths, group_of, wanted.collapsed, parts)
    return replace(walk, dof=wanted.noise_dof, beam_is_seen=seen, spreads=spreads, positive=positive)


def first_state(walk: Walk, seed: int, chain: int) -> ChainState:
    """Return where a chain begins: about the fit, wider than the posterior. Collective: the chain's ranks."""
    chance = Chance(seed, chain, -1)
    white = chance.of("effects").standard_normal(walk.proposal.factor.shape[1])
    n_local, n_groups = len(walk.channels), int(walk.group_of.max(initial=-1)) + 1
    misfit = walk.misfit(walk.unknowns.values, [one.mean for one in walk.seen_by])
    normals = walk.sums(walk.unknowns.values)
    noise, parts = np.ones(n_local), np.ones((n_local, 0))
    if walk.noise is not None:
        noise = misfit / np.array([max(one.n_data, 1) for one in normals])
    if walk.parts is not None:
        # Of the same size for all baselines, of however many factors.
        each = noise ** (1 / len(walk.parts.of_baseline))
        noise, parts = np.ones(n_local), np.repeat(each[:, np.newaxis], len(walk.parts.labels), axis=1)
    beams = tuple(one.mean for one in walk.seen_by)
    pace = np.ones(walk.unknowns.n_freqs + 1)
    spreads = np.ones(walk.unknowns.width_of.max(initial=-1) + 1)
    state = ChainState(walk.unknowns.values, beams, noise, np.ones((n_local, n_groups)), parts, pace, pace, spreads)
    walk = walk.weighed(state, chance)
    length = BEGINS_WIDE
    while True:
        moved = replace(state, values=walk.unknowns.at(walk.proposal.vector(np.multiply(length, white))))
        try:
            return replace(moved, beams=walk.drawn(walk.beams_given(moved), chance, "beam"))
        except InputError:
            # So far out that no beam can be solved for.
            if length < 1e-3:
                raise
            length *= 0.5


def _check_together(context: FitContext, wanted: Sample) -> None:
    """Make sure that nothing is drawn that is known of single channels alone, where they hang together."""
    if context.problem.coupling is None:
        return
    asked = {"blocks": PRIOR_WIDTH in wanted.blocks, "positive_beam": bool(wanted.positive_beam)}
    for key, what in (("blocks", PRIOR_WIDTH), ("positive_beam", "positive_beam")):
        if asked[key]:
            raise InputError(
                f"{what} does not go with beams that hang together over frequency",
                field=f"[sample] {key}",
                remedy="leave it out, or set [prior.frequency] kind = 'independent'",
            )


def _values(context: FitContext, job: Job) -> Values:
    """Return the effects of the job, and those that it has none of and that are to be drawn."""
    values = restore(job, context.setup, context.learned)
    there = {one.kind for one in values.active}
    further = {one.kind: one for one in job.sample.effects}
    for kind in job.sample.blocks:
        if kind in EFFECTS and kind not in there:
            further.setdefault(kind, SampledEffect(kind=kind))
    for number, (kind, one) in enumerate(further.items()):
        try:
            if kind in there:
                raise InputError("is among the [[effects]] of the job", remedy="leave it out here")
            values = values.extended(_further(context.setup, one))
        except InputError as error:
            error.within(f"[[sample.effects]] number {number + 1} ({kind})")
            raise
    return values


def _further(setup: ObservingSetup, one: SampledEffect) -> Active:
    """Return an effect at zero, with a prior of so many times the natural sizes of its parameters."""
    effect = make_effect(one.kind, one.settings)
    reason = effect.not_applicable(setup)
    if reason is not None:
        raise InputError(reason, remedy="leave it out")
    if one.foremost is not None:
        if not isinstance(effect, ScannedEffect):
            raise InputError("has no candidates", field="foremost", remedy="leave it out")
        effect = effect.foremost(setup, one.foremost)
    effect = effect.in_full(setup)
    parameters = effect.parameters(setup)
    if not len(parameters):
        raise InputError("has nothing to be drawn", field="settings", remedy="say which there are, or foremost = N")
    std = one.width * parameters.scale
    names = [name for name, nonlinear in zip(parameters.names, parameters.nonlinear, strict=True) if not nonlinear]
    for name, own in one.prior_std.items():
        if name not in names:
            remedy = f"use names such as '{names[0]}', '{names[-1]}'"
            raise InputError(f"has no parameter '{name}' with a width", field="prior_std", remedy=remedy)
        std[parameters.names.index(name)] = own
    return Active.start(effect, setup, std**2, np.zeros(len(parameters)))


def _moving(values: Values, wanted: Sample) -> tuple[int, ...]:
    """Return the places of the effects that are drawn."""
    places = range(len(values.active))
    return tuple(place for place in places if not wanted.blocks or values.active[place].kind in wanted.blocks)


def _width_of(context: FitContext, unknowns: Unknowns, wanted: Sample) -> IntArray:
    """Return the number of the width of each unknown whose prior's is drawn, or -1; empty where there are none.

    Raises
    ------
    InputError
        If some of their combinations are held.
    """
    kinds = {one.kind for one in wanted.effects if one.draw_widths}
    width_of, n_widths = np.full(unknowns.size, -1), 0
    for one, span in zip(unknowns.active, unknowns.spans, strict=True):
        if one.kind not in kinds:
            continue
        if np.any(one.held):
            raise InputError(
                "has combinations of parameters that no data can tell from another beam",
                field=f"[[sample.effects]] ({one.kind}) draw_widths",
                remedy="leave it out",
            )
        parameters = one.effect.parameters(context.setup)
        of_set = np.unique(parameters.element[one.used], return_inverse=True)[1]
        n_sets, n_groups = unknowns.vector(unknowns.values)[span].size // one.size, int(of_set.max()) + 1
        numbers = n_widths + n_groups * np.arange(n_sets)[:, np.newaxis] + of_set
        width_of[span] = np.where(parameters.nonlinear[one.used], -1, numbers).reshape(-1)
        n_widths += n_sets * n_groups
    return width_of if n_widths else np.zeros(0, dtype=int)


def _groups(context: FitContext, wanted: Sample) -> IntArray:
    """Return the group of each mode of the beam, (n_modes,); none where widths are not drawn."""
    if PRIOR_WIDTH not in wanted.blocks:
        return np.zeros(0, dtype=int)
    basis, field = context.problem.basis, "[sample] blocks"
    independent = [isinstance(one, DiagonalPrior) and one.shape is None for one in context.problem.priors]
    if context.learned or not all(independent):
        raise InputError(
            f"{PRIOR_WIDTH} is of a prior with independent coefficients, and this one has none",
            field=field,
            remedy="leave it out, or set [prior] kind = 'fraction' and shape = false",
        )
    if wanted.width_groups == "all":
        return np.zeros(basis.n_modes, dtype=int)
    modes = getattr(basis, "modes", None)
    if modes is None:
        raise InputError("this basis has no orders", field="[sample] width_groups", remedy="set it to 'all'")
    radial, azimuthal = np.array(modes).T
    orders = radial if wanted.width_groups == "radial" else np.abs(azimuthal)
    return np.asarray(np.unique(orders, return_inverse=True)[1])


def _with_fixed_weights(context: FitContext, fitted: Fitted) -> tuple[FitContext, Fitted]:
    """Return the same where what the fit made of the weights is what they are: chains take them as known. Serial."""
    if not fitted.values.reweighted:
        return context, fitted
    share, plain = context.train, replace(fitted.values, reweighted=())
    told = share.calibrated(fitted.estimate)[0].inv_noise_var
    stated = share.calibrated(Estimate(plain, fitted.fit.posteriors))[0].inv_noise_var
    factor = np.divide(told, stated, out=np.zeros_like(told), where=stated > 0)
    rows = replace(share.rows, inv_noise_var=share.rows.inv_noise_var * factor)
    train = RankData(share.problem, share.setup, rows, kept_bytes=share.kept_bytes)
    return replace(context, train=train), replace(fitted, values=plain)


def _by_misfit(context: FitContext, fitted: Fitted, n_free: int) -> tuple[FitContext, Fitted]:
    """Fit once more with noise as large as what the fit leaves of the data, and tell where. Collective: chain's ranks.

    The smaller the weights the more the prior holds; chains are where both belong together.
    """
    share, values, told = context.train, fitted.values, fitted.diagnostics
    mean = solve_beams(context, fitted.estimate, keep=True)
    scale = None
    if context.grid.is_group_root:
        decided = 0.5 * (told.effective_parameters + n_free / context.setup.observation.Nfreqs)
        scale = mean.train_chi2 * told.n_data / np.maximum(told.n_data - decided, 1.0)
    scale = bcast_array(context.grid.group, scale)
    weighed = replace(context, train=share.weighed(1 / scale[:, np.newaxis, np.newaxis]))
    return weighed, refit(weighed, values, fitted)


def _proposal(context: FitContext, fitted: Fitted, unknowns: Unknowns) -> Proposal:
    """Return the Gaussian of the effects about the fit, the beams marginalised. Collective: the chain's ranks."""
    vector = unknowns.vector(fitted.values)
    free = unknowns.free
    # Rounding may have left a little of what is held at zero.
    vector = free @ (free.T @ vector)
    if not unknowns.moving:
        return Proposal(vector, free, free.T)
    at = Estimate(unknowns.at(vector), fitted.fit.posteriors)
    solved = solve_beams(context, at)
    at, found = replace(at, beams=solved.beams), None
    posterior = None
    if context.problem.coupling is None:
        told, _ = linearised(context, at, solved, at.values)
        if told is not None:
            posterior = partial(unknowns.posterior, vector, told, np.ones(len(told)))
    else:
        sums = list(sums_at(context, at, solved.rows, solved.added, at.values))
        known = marginal_together(context, at.values, sums, solved.together)
        if known is not None:
            posterior = partial(unknowns.posterior_together, vector, *known)
    with together(context.grid.world):
        if posterior is not None:
            mean, factor = posterior()
            half = solve_triangular(factor, free.T, lower=True, check_finite=False)
            found = Proposal(vector + free @ mean, half.T, factor.T @ free.T)
    made: Proposal = bcast_object(context.grid.world, found)
    return made


def _beam_is_seen(context: FitContext, unknowns: Unknowns, proposal: Proposal, beams: tuple[Posterior, ...]) -> bool:
    """Tell whether another beam makes another E or C, wherever effects are. Collective: the chain's ranks."""
    values = unknowns.at(proposal.vector(np.ones(proposal.factor.shape[1])))
    others = tuple(replace(one, mean=1.1 * one.mean + one.mean[::-1]) for one in beams)
    with together(context.grid.world):
        of_each = [context.train.effects(Estimate(values, some)) for some in (beams, others)]
        same = all(np.array_equal(one, two) for one, two in zip(*of_each, strict=True))
    return not all(context.grid.world.allgather(same))
