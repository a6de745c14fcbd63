"""What it takes rank 0 to solve for beams that hang together over frequency: timed on fewer modes and channels.

With M modes of n coefficients and N channels, sums, factor, inverse and the covariances of the channels take of the
order of N M^2 n^2 and M^3 n^3. Fewer of both in the same proportion take by the cube of it less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.coupled import MOST_REFINED, dense_unknowns
from hydrabeam_mpi.inference.coupled import ChannelTold, CoupledEquations
from hydrabeam_mpi.planning.outline import Clock, Outline
from hydrabeam_mpi.random import generator

MOST_UNKNOWNS = 1500
"""Of the system that is timed: as large as products need to be to run as fast as with more, and solved in a second."""
STEPS_A_FIT = 4
"""Of a fit of effects, each of which solves for all beams."""


@dataclass(frozen=True)
class SolvedTogether:
    """Seconds on rank 0.

    Attributes
    ----------
    factor_s : float
        Until the system of one length is factorised, which tells its evidence.
    moments_s : float
        Of the covariances and draws of all channels.
    n_lengths : int
        Among which the evidence decides.
    """

    factor_s: float
    moments_s: float
    n_lengths: int

    @property
    def inference_s(self) -> float:
        """Seconds of an inference: the length that is likeliest is solved for once more."""
        return self.factor_s * (1 + self.n_lengths * (self.n_lengths > 1)) + self.moments_s

    @property
    def fit_s(self) -> float:
        """Seconds of a fit with effects."""
        return STEPS_A_FIT * (self.factor_s + self.moments_s)


def solved_together(outline: Outline, clock: Clock) -> SolvedTogether | None:
    """Time it; None where channels are independent.

    Raises
    ------
    InputError
        If the job asks for conjugate gradients.
    """
    coupling, basis = outline.coupling, outline.problem.basis
    if coupling is None:
        return None
    n, n_modes = basis.n_modes, max(modes.shape[1] for modes in coupling.candidates)
    if not dense_unknowns(coupling, n):
        raise InputError(
            "how many steps conjugate gradients take is not known before they are done",
            field="[prior.frequency] solver",
            remedy="plan with solver = 'dense', or with kind = 'independent', which takes less",
        )
    few = min(n_modes, max(1, MOST_UNKNOWNS // n))
    n_channels = max(few, round(outline.n_channels * few / n_modes))
    rng = generator(0, "plan", few)
    modes = np.linalg.qr(rng.standard_normal((n_channels, few)))[0] * np.sqrt(n_channels / few)
    information = np.eye(n, dtype=complex if basis.is_complex else float)
    told, noise = ChannelTold(information, information[0]), np.zeros((n, outline.job.output.draws), information.dtype)
    start = clock()
    equations = CoupledEquations(modes, n, basis.is_complex, noise.shape[1])
    for channel in range(n_channels):
        equations.add(channel, told, noise)
    posterior = equations.solve()
    factorised = clock()
    for _ in posterior.moments(0, range(noise.shape[1])):
        pass
    larger = (n_modes / few) ** 3
    n_lengths = len(coupling.candidates) + MOST_REFINED * coupling.may_refine
    return SolvedTogether((factorised - start) * larger, (clock() - factorised) * larger, n_lengths)
