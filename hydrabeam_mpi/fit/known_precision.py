"""How well data tell the beams depends on their weights and on the sky alone: what was worked out once for these.

Steps of effects that only add visibilities change neither, so that of the sums over rows only A^H N^-1 d is made anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import Comm


@dataclass(frozen=True)
class Key:
    """What the precision of a rank's beams follows from.

    Attributes
    ----------
    weights : ndarray, (Nlocal, Ntimes, Nbls)
    sky : bytes
        Key of the effects that change the sky; see `RowModel.key_of_sky`.
    prior : tuple
        Where the beams' prior has its precision from.
    prior_widths : PriorWidths, optional
        Where they are not the stated ones.
    """

    weights: FloatArray
    sky: bytes
    prior: tuple[object, ...]
    prior_widths: PriorWidths | None

    def is_same(self, other: Key) -> bool:
        """Whether both have the same weights, the same sky and the same prior."""
        same_prior = all(one is two for one, two in zip(self.prior, other.prior, strict=True))
        same_prior = same_prior and self.prior_widths == other.prior_widths
        return same_prior and self.sky == other.sky and np.array_equal(self.weights, other.weights)


@dataclass(frozen=True)
class KnownPrecision:
    """What a rank's weights and the sky tell of the beams of its channels.

    Attributes
    ----------
    key : Key
    grams, factors : list of ndarray, (n_modes, n_modes)
        A^H N^-1 A of all ranks' rows, and the factors of the posterior precision; of each channel. No factors where
        they are not those of the weights as they are, as in a chain that draws the size of the noise.
    """

    key: Key
    grams: Sequence[Array]
    factors: Sequence[Array] | None

    @classmethod
    def of(cls, key: Key, normals: Sequence[NormalEquations], beams: Sequence[Posterior] | None) -> KnownPrecision:
        """Keep what has been worked out."""
        factors = None if beams is None else [one.factor for one in beams]
        return cls(key, [one.own(BEAM) for one in normals], factors)


class RecentlyKnown:
    """The precision that was worked out last, and the one that was of use last."""

    def __init__(self) -> None:
        self._of_use: KnownPrecision | None = None
        self._last: KnownPrecision | None = None

    def find(self, comm: Comm, key: Key) -> KnownPrecision | None:
        """Return what holds for the rows of all ranks of `comm`, if it is known. Collective: all ranks of `comm`."""
        here = [one is not None and one.key.is_same(key) for one in (self._of_use, self._last)]
        there = np.all(comm.allgather(here), axis=0)
        if there.any():
            self._of_use = self._of_use if there[0] else self._last
            return self._of_use
        return None

    def keep(self, known: KnownPrecision) -> None:
        """Keep what was worked out."""
        self._last = known
