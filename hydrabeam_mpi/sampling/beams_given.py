"""The beams given all else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import Prior


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
        ln p(d | x, s, t) up to a constant; on the group's root alone.
    """

    normals: list[NormalEquations]
    posteriors: list[Posterior]
    log_evidence: FloatArray


def solve_beam(normal: NormalEquations, prior: Prior) -> tuple[Posterior, float]:
    """Return a beam's posterior, and ln of the evidence of the data up to a constant, also where a prior is flat."""
    gaussian = normal.gaussian({BEAM: prior})
    posterior = gaussian.solve(overwrite=True)
    log_det = 2 * float(np.sum(np.log(np.diag(posterior.factor).real)))
    told = float(np.vdot(gaussian.source, posterior.mean).real)
    known = float(np.vdot(prior.mean, prior.precision_times(prior.mean)).real) - (prior.log_det_precision or 0.0)
    return posterior, normal.log_det_inv_noise - normal.data_norm + (told - log_det - known) / gaussian.kappa
