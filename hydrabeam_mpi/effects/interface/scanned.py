"""Effects with very many candidates: each is looked at by itself before the best of them are weighed together."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.changing import ScannedInTime
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.errors import InputError


class ScannedEffect(ScannedInTime, Effect):
    """An effect with too many candidates to fit together: they are scanned one by one first."""

    @property
    def gets_simpler_when_fitted(self) -> bool:
        """Whether candidates lie on a grid, from which a fit moves on to the best values in between."""
        return not self.linear

    most_again: ClassVar[int] = 350
    """How many of the best of a scan are compared together, or looked at again beside the beam, see `every`."""

    @property
    def scanned_as(self) -> ScannedEffect:
        """The effect that has the same candidates and is scanned in the same pass, this one where there is none."""
        return self

    @abstractmethod
    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of candidates."""

    @abstractmethod
    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Return Re sum w s* r and sum w |s|^2 of every candidate's columns s, each (n_hypotheses, p).

        r is ``block.residual``, w ``block.weights``; sums over the block's rows alone. The p columns of a candidate are
        taken as orthogonal.
        """

    @abstractmethod
    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> Effect:
        """Return the effect with these candidates as its elements, in this order; ``hypotheses`` is (Nchosen,)."""

    def expanded(self, setup: ObservingSetup, hypotheses: IntArray) -> IntArray:
        """Return these candidates with others that a scan cannot tell from them, to be looked at again; (Nall,)."""
        return hypotheses

    def of_the_same(self, setup: ObservingSetup) -> IntArray:
        """Return which of the things that are looked at each candidate is a form of, a number each, (n_hypotheses,)."""
        return np.arange(self.n_hypotheses(setup))

    def every(self, setup: ObservingSetup, hypotheses: IntArray) -> Effect | None:
        """Return the effect with all of these candidates, (Nchosen,), as its elements, whether or not they are alike.

        None where the beam cannot take up so much of any that a scan, with the beam as it is, overlooks it.
        """
        return None

    def foremost(self, setup: ObservingSetup, n: int) -> Effect:
        """Return the effect with the ``n`` candidates that matter most by what is known before any data are seen.

        Raises
        ------
        InputError
            If none matters more than another.
        """
        raise InputError(
            "has no candidates that matter more than others", field="foremost", remedy="say which in settings"
        )

    def drawn(self, setup: ObservingSetup, rng: np.random.Generator) -> Effect:
        """Pick a candidate at random."""
        return self.at(setup, rng.integers(self.n_hypotheses(setup), size=1))


def sums_by(place: IntArray, values: ComplexArray, block: RowBlock, n: int) -> tuple[FloatArray, FloatArray]:
    """Return Re sum w s* r and sum w |s|^2 of columns s of a block's rows, each (n,).

    Parameters
    ----------
    place : ndarray of int, broadcastable to (Ntimes, Nbls, k)
        Which of the ``n`` sums each value is part of.
    values : ndarray of complex, (Ntimes, Nbls, k)
    block : RowBlock
    n : int
    """
    where, weights = np.broadcast_to(place, values.shape).ravel(), block.weights[..., np.newaxis]
    told = weights * (values.conj() * block.residual[..., np.newaxis]).real
    power = weights * np.abs(values) ** 2
    # Without any row a count is of whole numbers.
    return np.bincount(where, told.ravel(), n).astype(float), np.bincount(where, power.ravel(), n).astype(float)
