"""Where a chain is: all that its next draw follows from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.random import generator


@dataclass(frozen=True)
class ChainState:
    """Where a chain is.

    Attributes
    ----------
    values : Values
        The effects; all channels, the same on all ranks.
    beams : tuple of ndarray, (n_modes,)
        Coefficients of the beams of this rank group's channels.
    noise : ndarray, (Nlocal,)
        By what the variance of the noise exceeds the stated one.
    widths : ndarray, (Nlocal, n_groups)
        By what the variances of the beams' prior exceed the stated ones, for each group of modes.
    parts : ndarray, (Nlocal, n_parts)
        By what those of the noise of parts of the array do, on top of that.
    step, scale : ndarray, (Nfreqs + 1,)
        Of the proposals of effects in single channels, and of those in all together: how far they go, 0 to 1, and how
        much wider than the fit's Gaussian they are. The same on all ranks.
    spreads : ndarray, (n_widths,)
        By what variances of the effects' priors exceed the stated ones; the same on all ranks.
    """

    values: Values
    beams: tuple[Array, ...]
    noise: FloatArray
    widths: FloatArray
    parts: FloatArray
    step: FloatArray
    scale: FloatArray
    spreads: FloatArray = field(default_factory=lambda: np.ones(0))


@dataclass(frozen=True)
class Chance:
    """The random numbers of one sweep of one chain: told by what they are for, never by a rank or an order of calls.

    Attributes
    ----------
    seed, chain, sweep : int
        Sweeps count from the chain's first on.
    warming_up : bool
        Whether proposals may still learn; afterwards they are as they are.
    """

    seed: int
    chain: int
    sweep: int
    warming_up: bool = False

    def of(self, *what: int | str) -> np.random.Generator:
        """Return the generator of what is drawn."""
        return generator(self.seed, "chain", self.chain, self.sweep, *what)
