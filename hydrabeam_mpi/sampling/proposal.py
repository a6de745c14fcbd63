"""The Gaussian from which effects are proposed."""

from __future__ import annotations

from dataclasses import dataclass

from hydrabeam_mpi.data.observation import FloatArray


@dataclass(frozen=True)
class Proposal:
    """The Gaussian that the joint fit says effects have, the beams marginalised: from where they are proposed.

    Attributes
    ----------
    centre : ndarray, (n,)
    factor : ndarray, (n, n_free)
        F with F F^T the covariance.
    inverse : ndarray, (n_free, n)
        From deviations to numbers of variance one.
    """

    centre: FloatArray
    factor: FloatArray
    inverse: FloatArray

    def vector(self, white: FloatArray) -> FloatArray:
        """Return the parameters, (n,), of numbers of variance one, (n_free,)."""
        return self.centre + self.factor @ white

    def white(self, vector: FloatArray) -> FloatArray:
        """Return the numbers, (n_free,), of some parameters, (n,)."""
        return self.inverse @ (vector - self.centre)
