"""The beams given all else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.inference.coupled import CoupledPosterior
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.mpi import together
from hydrabeam_mpi.sampling.coupled import solve_together


@dataclass(frozen=True)
class BeamsGiven:
    """The beams given all else, E and C as seen by the fit's beams.

    Attributes
    ----------
    normals : list of NormalEquations
        By the stated noise.
    posteriors : list of Posterior
        On the group's root alone.
    log_evidence : ndarray, (Nlocal,)
        ln p(d | x, s, t) up to a constant; on the group's root alone. Where channels hang together, their share of
        that of all.
    together : CoupledPosterior, optional
        The beams of all channels where they hang together, on rank 0; there are no others then.
    """

    normals: list[NormalEquations]
    posteriors: list[Posterior]
    log_evidence: FloatArray
    together: CoupledPosterior | None = None


def solve_given(
    context: FitContext, normals: list[NormalEquations], noise: FloatArray, priors: Sequence[Prior]
) -> BeamsGiven:
    """Solve for the beams of the group's channels. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    normals : list of NormalEquations
        By the stated noise.
    noise : ndarray, (Nlocal,)
        Scale of its variance.
    priors : sequence of Prior
    """
    posteriors, evidence, scaled = [], np.zeros(len(normals)), list[NormalEquations]()
    with together(context.grid.world):
        if context.grid.is_group_root:
            scaled = [one.with_noise(scale) for one, scale in zip(normals, noise.tolist(), strict=True)]
    if context.problem.coupling is not None:
        joint, total = solve_together(context, scaled, priors)
        return BeamsGiven(normals, [], np.full(len(normals), total / context.grid.n_channels), joint)
    with together(context.grid.world):
        for f, (normal, prior) in enumerate(zip(scaled, priors, strict=False)):
            posterior, evidence[f] = solve_beam(normal, prior)
            posteriors.append(posterior)
    return BeamsGiven(normals, posteriors, evidence)


def solve_beam(normal: NormalEquations, prior: Prior) -> tuple[Posterior, float]:
    """Return a beam's posterior, and ln of the evidence of the data up to a constant, also where a prior is flat."""
    gaussian = normal.gaussian({BEAM: prior})
    posterior = gaussian.solve(overwrite=True)
    log_det = 2 * float(np.sum(np.log(np.diag(posterior.factor).real)))
    told = float(np.vdot(gaussian.source, posterior.mean).real)
    known = float(np.vdot(prior.mean, prior.precision_times(prior.mean)).real) - (prior.log_det_precision or 0.0)
    return posterior, normal.log_det_inv_noise - normal.data_norm + (told - log_det - known) / gaussian.kappa
