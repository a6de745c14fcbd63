"""The Newton step of effects where beams hang together over frequency: beams and effects of all channels as one system.

The beams are those of `hydrabeam_mpi.inference.coupled`: their modes c have the posterior precision P = L L^H given the
effects. With G_f the products of a channel's columns of the beam and of the parameters x_f, in units of the prior's
widths, and K = (U_1 G_1, U_2 G_2, ...), the modes follow the parameters of all channels, and take of what is known of
them (the Schur complement),

    c(x) = c_0 + R (x - x_0),    R = -kappa P^-1 K,        J = diag(2 Re S_f^H N^-1 S_f) - 2 kappa Re K^H P^-1 K,

with kappa as in `hydrabeam_mpi.inference.gaussian`. From the covariance C of the parameters of all channels follows
what is to be known of each channel, all of the others marginalised: with r_f = U_f R

    cov(a_f, x_f) = r_f C_f = M_f C_ff,        cov(a_f | x_f) = cov(a_f | x) + r_f C r_f^H - M_f C_ff M_f^H,

of the same form as for a channel by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.effects.registry import EFFECTS
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.coupled import dense_unknowns, posterior_of
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.joint_step import solve_together
from hydrabeam_mpi.fit.marginal import in_parts
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.inference.coupled import CoupledPosterior
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.matrices import inverse_where_it_varies
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import bcast_array, gather_by_channel, share_by_channel, together
from hydrabeam_mpi.setup.problem import Problem

MAX_PARAMETERS = 5_000
"""Parameters of effects, in all channels, that are solved for with the beams: as many columns of the beams' matrix."""


@dataclass(frozen=True)
class OfChannel:
    """What a step says of one channel, all others marginalised, in units of the widths of the beam's prior.

    Attributes
    ----------
    moved : ndarray, (n,)
        By how much the beam follows.
    covariance : ndarray, (n, n)
        Of the beam given the channel's parameters.
    response : ndarray, (n, q)
        M.
    of_effects : ndarray, (q, q)
        C_ff.
    """

    moved: Array
    covariance: Array
    response: Array
    of_effects: FloatArray


@dataclass(frozen=True)
class JointStep:
    """A step of the effects of all channels, and how the beams follow.

    Attributes
    ----------
    x, std : ndarray, (Nfreqs, q)
    covariance : ndarray, (Nfreqs q, Nfreqs q)
        C.
    moved, gain : float
        As of `hydrabeam_mpi.fit.joint_step.solve_jointly`.
    response : ndarray, (M, n, Nfreqs q)
        R.
    """

    x: FloatArray
    std: FloatArray
    covariance: FloatArray
    moved: float
    gain: float
    response: Array

    @classmethod
    def of(
        cls, values: Values, beams: CoupledPosterior, likelihoods: Sequence[Likelihood], across: Sequence[Array]
    ) -> JointStep:
        """Take it on one rank.

        Parameters
        ----------
        values : Values
            Where the effects are.
        beams : CoupledPosterior
            Given these.
        likelihoods : sequence of Likelihood
            Of each channel's parameters, with the beams known.
        across : sequence of ndarray, (n, q)
            G.
        """
        information, half = _known_together(beams, likelihoods, across)
        solved = solve_together(values, information, np.array([one.score for one in likelihoods]))
        response = solve_triangular(beams.joint.factor, half, lower=True, trans="C", check_finite=False)
        return cls(*solved, -_kappa(beams) * response.reshape(beams.modes.shape[1], beams.n, -1))

    def response_of(self, beams: CoupledPosterior, channel: int) -> Array:
        """Return by how much a channel's beam follows the parameters of all channels, (n, Nfreqs q)."""
        return np.asarray(np.tensordot(beams.modes[channel], self.response, 1))

    def channels(self, beams: CoupledPosterior, change: FloatArray) -> Iterator[OfChannel]:
        """Yield what it says of each channel; the parameters' ``change``, (Nfreqs, q), is what beams follow."""
        q = self.x.shape[1]
        for channel in range(len(beams.modes)):
            own = slice(channel * q, (channel + 1) * q)
            follow = self.response_of(beams, channel)
            spread, of_effects = follow @ self.covariance, self.covariance[own, own]
            response = spread[:, own] @ inverse_where_it_varies(of_effects)
            covariance = beams.covariance_of(channel) + spread @ follow.conj().T
            covariance -= response @ of_effects @ response.conj().T
            yield OfChannel(follow @ change.ravel(), covariance, response, of_effects)


def step_together(
    context: FitContext, values: Values, sums: Sequence[NormalEquations], beams: CoupledPosterior | None
) -> JointStep | None:
    """Bring together what the channels say, and take the step on rank 0. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    values : Values
    sums : sequence of NormalEquations
        Of the group's channels, beam and effects in them.
    beams : CoupledPosterior, optional
        On rank 0.

    Raises
    ------
    InputError
        On all ranks, if the effects have too many parameters.
    """
    gathered, step = _gathered(context, values, sums), None
    with together(context.grid.world):
        if beams is not None:
            step = JointStep.of(values, beams, *zip(*gathered, strict=True))
    return step


def marginal_together(
    context: FitContext, values: Values, sums: Sequence[NormalEquations], beams: CoupledPosterior | None
) -> tuple[FloatArray, FloatArray] | None:
    """Return what all channels say of the parameters of all, the beams marginalised, on rank 0.

    Information, (Nfreqs q, Nfreqs q), and score, (Nfreqs, q); as of `step_together`. Collective: all ranks of the grid.
    """
    gathered, found = _gathered(context, values, sums), None
    with together(context.grid.world):
        if beams is not None:
            likelihoods, across = zip(*gathered, strict=True)
            found = _known_together(beams, likelihoods, across)[0], np.array([one.score for one in likelihoods])
    return found


def _known_together(
    beams: CoupledPosterior, likelihoods: Sequence[Likelihood], across: Sequence[Array]
) -> tuple[FloatArray, Array]:
    """Return J, (Nfreqs q, Nfreqs q), and L^-1 K, (M n, Nfreqs q); parameters as of `JointStep.of`."""
    columns = np.einsum("fm,fiq->mifq", beams.modes, np.array(across)).reshape(beams.modes.shape[1] * beams.n, -1)
    half = solve_triangular(beams.joint.factor, columns, lower=True, check_finite=False)
    parts = in_parts(half)
    return block_diag(*(one.signal for one in likelihoods)) - 2 * _kappa(beams) * (parts.T @ parts), half


def _kappa(beams: CoupledPosterior) -> float:
    return 1.0 if beams.joint.is_complex else 2.0


def _gathered(context: FitContext, values: Values, sums: Sequence[NormalEquations]) -> list[tuple[Likelihood, Array]]:
    """Return what each channel says with its beam known, and G, on rank 0. Collective: all ranks of the grid."""
    names, mine = list(values.blocks), []
    with together(context.grid.world):
        _check_number(values)
        if context.grid.is_group_root:
            for one, prior in zip(sums, context.problem.priors, strict=True):
                mine.append((one.likelihood_alone(names), prior.std()[:, np.newaxis] * one.gather([BEAM], names)))
    return gather_by_channel(context.grid, mine)


def _check_number(values: Values) -> None:
    if values.x.size > MAX_PARAMETERS:
        raise InputError(
            f"effects have {values.x.size} parameters in all channels, and beside beams that hang together over"
            f" frequency there is room for {MAX_PARAMETERS}",
            field="[prior.frequency] kind",
            remedy="set kind = 'independent', or take fewer channels, or effects with fewer parameters",
        )


def share_step(
    context: FitContext, step: JointStep | None, beams: CoupledPosterior | None, at: Sequence[Posterior], x: FloatArray
) -> tuple[tuple[Posterior, ...], tuple[FloatArray, ...], tuple[Array, ...]]:
    """Tell the groups what a step says of their channels. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    step : JointStep, optional
        On rank 0, as are the ``beams`` from which it was taken.
    at : sequence of Posterior
        The group's beams before it.
    x : ndarray, (Nfreqs, q)
        The effects' parameters before it.

    Returns
    -------
    beams : tuple of Posterior
        As they follow, given their channel's effects.
    covariances : tuple of ndarray, (q, q)
    responses : tuple of ndarray, (n, q)
    """
    found = share_by_channel(context.grid, step.channels(beams, step.x - x) if step and beams else ())
    mine: list[tuple[Array, ...]] = []
    with together(context.grid.world):
        for one, before, prior in zip(found, at, context.problem.priors, strict=False):
            width = prior.std()
            beam = posterior_of(before.mean + width * one.moved, one.covariance * width * width[:, np.newaxis])
            mine.append((beam.mean, beam.factor, one.of_effects, width[:, np.newaxis] * one.response))
    posteriors, covariances, responses = [], [], []
    for f in range(len(at)):
        parts = mine[f] if mine else (None,) * 4
        mean, factor, covariance, response = (bcast_array(context.grid.group, part) for part in parts)
        posteriors.append(Posterior(mean, factor))
        covariances.append(covariance)
        responses.append(response)
    return tuple(posteriors), tuple(covariances), tuple(responses)


def check_solved_with_effects(problem: Problem) -> None:
    """Make sure that beams that hang together can be solved for with effects.

    Raises
    ------
    InputError
        If there is no one matrix for them, or if an effect would let them hang together twice.
    """
    coupling = problem.coupling
    if coupling is None:
        return
    for number, entry in enumerate(problem.job.effects):
        if entry.kind in EFFECTS and not EFFECTS[entry.kind].is_sought:
            raise InputError(
                "is about beams of independent channels, and these hang together",
                field=f"[[effects]] number {number + 1} ({entry.kind})",
                remedy="remove it, or [prior.frequency]",
            )
    if len(coupling.candidates) > 1:
        raise InputError(
            "with effects in the model the evidence of several lengths is not worked out",
            field="[prior.frequency] length",
            remedy="give one: 'hydrabeam infer' without [[effects]] tells the likeliest in summary.json",
        )
    if not dense_unknowns(coupling, problem.basis.n_modes):
        raise InputError(
            "beams that hang together over frequency are solved for with effects by one matrix alone",
            field="[prior.frequency] solver",
            remedy="set solver = 'dense' where memory allows it, or ask for fewer modes along frequency",
        )
