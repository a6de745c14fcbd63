"""What no effect can be, whatever a fit has come to: fluxes below zero, transmissions that are not between 0 and 1."""

from __future__ import annotations

from typing import Self

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup


class HasLimits:
    """Something with fitted parameters that may be beyond what is physical; by default there are no limits."""

    unphysical: str = ""
    """What a part that is beyond its limits would have, in words."""

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Return by how many standard errors each parameter is beyond what is physical, (n_params,); zero within.

        Fitted parameters and their errors are (Nfreqs, n_params); errors are zero where they are not in use.
        """
        return np.zeros(x.shape[1])

    def without(self, gone: BoolArray) -> tuple[Self, IntArray]:
        """Return the effect without what some parameters belong to, and the numbers of those left, (n_left,).

        ``gone`` is (n_params,). Only where there are limits.
        """
        raise NotImplementedError


def sigmas(excess: FloatArray, error: FloatArray) -> FloatArray:
    """Return an excess in standard errors, zero where it is none and where there is no error; all of one shape."""
    return np.divide(excess, error, out=np.zeros_like(excess), where=(error > 0) & (excess > 0))
