"""The beams given the effects, and how likely both are together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray
from hydrabeam_mpi.fit.accumulate import accumulate_designs
from hydrabeam_mpi.fit.channels import reduced_chi2, solve_channels
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.known_precision import Key, KnownPrecision
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Diagnostics, Estimate, Values
from hydrabeam_mpi.inference.coupled import CoupledPosterior
from hydrabeam_mpi.inference.over_frequency import inverse_over_channels
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum, together
from hydrabeam_mpi.setup.problem import Problem


@dataclass(frozen=True)
class Solved:
    """The beams given the effects, and the sums over rows that tell them.

    ``reached`` is ln(likelihood x prior) of the effects with the beams that E is seen by, or with ``beams`` if there is
    no E; ``rises`` by how much it would be higher with ``beams``, were E the same for them. ``log_joint``, (Nlocal,),
    is that of ``beams`` without the prior of the effects. ``together`` is the posterior of the beams of all channels,
    on rank 0, where these hang together.
    """

    beams: tuple[Posterior, ...]
    normals: list[NormalEquations]
    rows: Rows
    added: ComplexArray
    reached: float
    rises: float
    log_joint: FloatArray
    together: CoupledPosterior | None = None

    @property
    def train_chi2(self) -> FloatArray:
        """Reduced chi^2 of the fitted rows, (Nlocal,)."""
        return np.array(list(map(reduced_chi2, self.normals, self.beams)))


def total_log_joint(context: FitContext, values: Values, of_beams: FloatArray, of_nonlinear: bool = True) -> float:
    """Return ln(likelihood x prior) of beams and effects, over all channels. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    values : Values
    of_beams : ndarray, (Nlocal,)
        That of the rank group's beams given the values; see `Diagnostics.log_joint`.
    of_nonlinear : bool
        Whether the prior of `nonlinear` parameters counts. Where effects are compared it does not: places and the like
        are priced by the number of candidates.
    """
    total = context.over_channels(of_beams)
    for one in values.active:
        left_out = one.effect.parameters(context.setup).nonlinear[one.used] & (not of_nonlinear)
        total += one.prior.log_density(np.where(left_out, 0.0, one.x[:, one.used]))
    return total + (context.learned.log_likelihood(values) if context.learned else 0.0)


@dataclass(frozen=True)
class BeamSums:
    """The sums over rows that tell the beams given the effects, of all ranks of the group.

    ``known`` is what has been worked out before for the same weights and the same sky, which are told by ``key``.
    ``left_out``, (Nlocal,), is what the rows cost in ln likelihood that changes of the weights leave out.
    """

    normals: list[NormalEquations]
    rows: Rows
    added: ComplexArray
    key: Key
    known: KnownPrecision | None
    left_out: FloatArray


def sum_for_beams(context: FitContext, at: Estimate) -> BeamSums:
    """Sum over the rows with the effects taken out, E as seen by the beams ``at``. Collective: all ranks of the grid.

    What depends on weights and sky alone is not summed again where these are as they were.
    """
    grid, share = context.grid, context.train
    with together(grid.world):
        rows, added = share.calibrated(at) if at.beams else (share.rows, np.zeros_like(share.rows.data))
    # Effects move the mean of the beams' prior at most.
    prior = context.problem, context.learned
    key = Key(rows.inv_noise_var, share.key_of_sky(at.values), prior, at.values.prior_widths)
    known = share.known.find(grid.group, key)
    with together(grid.world):
        designs = share.designs(at.values, show=grid.world.rank == 0 and not at.beams)
        normals = accumulate_designs(rows, designs, context.problem.basis, None if known is None else known.grams)
    for normal in normals:
        normal.reduce(grid.group)
    return BeamSums(
        normals, rows, added, key, known, price_of_left_out(context, share, at.values, rows.inv_noise_var > 0)
    )


def price_of_left_out(context: FitContext, share: RankData, values: Values, kept: BoolArray) -> FloatArray:
    """Return what the rows cost in ln likelihood that changes of the weights leave out, (Nlocal,).

    See `Reweighting.price`. Of the rows of ``share``, the fitted or the held-out ones, those ``kept`` are (Nlocal,
    Ntimes, Nbls). Collective: all ranks of the grid.
    """
    price = np.zeros(len(context.channels))
    changes = [one for one in values.reweighted if one.change.leaves_out]
    if not changes:
        return price
    tile = share.rows.tile
    left_out = (share.rows.inv_noise_var > 0) & ~kept
    for channel, number in enumerate(context.channels):
        # What several would leave out costs what the cheapest of them asks.
        asked = [one.change.price(context.setup, number, tile.times, tile.bls, one.x[number]) for one in changes]
        price[channel] = float(np.min(asked, axis=0)[left_out[channel]].sum())
    allreduce_sum(context.grid.group, price)
    return price


def solve_beams(context: FitContext, at: Estimate, keep: bool = False) -> Solved:
    """Solve for the beams given the effects, E as seen by the beams ``at``; with ``keep`` these stay.

    Collective: all ranks of the grid.
    """
    problem, sums = context.given(at.values), sum_for_beams(context, at)
    normals, known = sums.normals, sums.known
    is_coupled = problem.coupling is not None
    solved, coupled = solve_channels(context.grid, problem, normals, None if known is None else known.factors)
    beams = tuple(solved)
    if known is None:
        context.train.known.keep(KnownPrecision.of(sums.key, normals, None if is_coupled else beams))
    if keep:
        beams = tuple(replace(two, mean=one.mean) for one, two in zip(at.beams, beams, strict=True))
    # E is that of the beams before, so that only those tell what beams and effects reach together.
    seen_by = at.beams if at.beams and at.values.adds else beams
    of_seen, of_beams = (log_joints(context.grid, problem, normals, one) - sums.left_out for one in (seen_by, beams))
    reached, best = (total_log_joint(context, at.values, one) for one in (of_seen, of_beams))
    joint = coupled.joint if coupled else None
    return Solved(beams, normals, sums.rows, sums.added, reached, best - reached, of_beams, joint)


def diagnostics_of(context: FitContext, solved: Solved) -> Diagnostics:
    """Tell how well the fitted rows are fitted. Serial."""
    normals, beams = solved.normals, solved.beams
    effective = list(map(_effective, normals, beams)) if context.grid.is_group_root else []
    n_data = np.array([float(normal.n_data) for normal in normals])
    return Diagnostics(solved.train_chi2, solved.log_joint, np.array(effective), n_data)


def log_joints(
    grid: ProcessGrid, problem: Problem, normals: Sequence[NormalEquations], beams: Sequence[Posterior]
) -> FloatArray:
    """Return ln(likelihood x prior) at the means, up to terms that neither effects nor beams change, (Nlocal,).

    Where channels hang together the prior of all is shared out among them. Collective: all ranks of the grid.
    """
    if problem.coupling is None:
        pairs = [(one.mean - prior.mean, prior) for one, prior in zip(beams, problem.priors, strict=True)]
        penalties = [np.vdot(away, prior.precision_times(away)).real for away, prior in pairs]
    else:
        widths = [prior.std() for prior in problem.priors]
        away = [(one.mean - prior.mean) / s for one, prior, s in zip(beams, problem.priors, widths, strict=True)]
        parts = grid.world.allgather((problem.channel_numbers.tolist(), away) if grid.is_group_root else ([], []))
        of_all = dict(pair for numbers, part in parts for pair in zip(numbers, part, strict=True))
        inverse = inverse_over_channels(problem.coupling.candidates[0])
        pulled = inverse[problem.channel_numbers] @ np.array([of_all[f] for f in sorted(of_all)])
        penalties = [np.vdot(one, pull).real for one, pull in zip(away, pulled, strict=True)]
    kappa = 1 if problem.basis.is_complex else 2
    chi2 = [reduced_chi2(one, beam) * max(one.n_data, 1) for one, beam in zip(normals, beams, strict=True)]
    return np.array([-fit - float(penalty) / kappa for fit, penalty in zip(chi2, penalties, strict=True)])


def _effective(normal: NormalEquations, posterior: Posterior) -> float:
    """Return how many real parameters the data have decided, tr(P^-1 kappa F^H N^-1 F) for real coefficients."""
    return 2 * float(np.sum(posterior.covariance * normal.own(BEAM).T).real)
