"""What effects on single baselines have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.errors import InputError


class PerBaseline(ScannedEffect):
    """A complex number x_ij of each baseline and channel that changes V_ij by x_ij p_ij(t), with p what is known.

    These are those of the baseline as the data have it, in whose sense the parameters are named. Rows are in the sense
    of their group; where that is the other one they have the conjugate.

    Parameters
    ----------
    baselines : sequence of (antenna number, antenna number)
        In either order; none for an effect that is to be scanned.
    """

    local = "baselines"
    parts: ClassVar[tuple[str, str]] = ("real", "imaginary")
    """What the number consists of; the second part changes its sign with the baseline's sense."""
    units: ClassVar[tuple[str, str]] = ("", "")
    scale: ClassVar[float]

    def __init__(self, baselines: Sequence[Sequence[int]] = ()) -> None:
        self.baselines = tuple((int(one), int(two)) for one, two in baselines)

    @abstractmethod
    def signature(self, block: RowBlock) -> NDArray[Any]:
        """Return p, (Ntimes, Nbls), or (Ntimes, 1) where all baselines share it."""

    def describe(self) -> dict[str, Any]:
        """Return the baselines."""
        return {"baselines": [list(pair) for pair in self.baselines]}

    def carried_over(self, setup: ObservingSetup) -> Self | str:
        """Return the effect on those of the baselines that other data have."""
        there = set(map(frozenset, setup.observation.antpairs.tolist()))
        return type(self)([pair for pair in self.baselines if frozenset(pair) in there])

    def known_as(self, names: Sequence[str]) -> dict[str, tuple[int, float]]:
        """Return the parameters by the baselines' names in either sense, in which they are conjugates."""
        known = {}
        for number, name in enumerate(names):
            one, two = self.baselines[number // 2]
            part = self.parts[number % 2]
            for called in (f"baseline {one}-{two} {part}", f"baseline {two}-{one} {part}"):
                known[called] = number, -1.0 if called != name and number % 2 else 1.0
        return known

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return both parts of every baseline's number."""
        pairs = setup.observation.antpairs[self._places(setup)]
        names = [f"baseline {one}-{two} {part}" for one, two in pairs.tolist() for part in self.parts]
        element = np.repeat(np.arange(len(pairs)), 2)
        return Parameters.of(names, self.units * len(pairs), self.scale, element, trials=self.n_hypotheses(setup))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return p and i p, where a row is one of the baselines; ``x`` is (n_params,)."""
        n = len(self.baselines)
        if not n:
            return Columns(np.zeros((*block.shape, 0), dtype=complex), 0)
        element = self.elements(block)[:, np.newaxis]
        parts = np.stack([np.ones(len(element)), 1j * sense_of(block.setup)[block.bls]], axis=-1)
        parts = np.where(element >= 0, parts, 0)
        values = self.signature(block)[..., np.newaxis] * parts
        return Columns(values, 2 * n, 2 * np.maximum(element, 0) + np.arange(2))

    def elements(self, block: RowBlock) -> IntArray:
        """Return which of the effect's baselines each row is, -1 where it is none, (Nbls,)."""
        element = np.full(len(block.setup.observation.antpairs), -1)
        element[self._places(block.setup)] = np.arange(len(self.baselines))
        return element[block.bls]

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of baselines."""
        return len(setup.observation.antpairs)

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Return the sums for both parts of every baseline, (Nbls, 2)."""
        signature = self.signature(block)
        told: ComplexArray = np.sum(block.weights * signature.conj() * block.residual, axis=0)
        power: FloatArray = np.sum(block.weights * np.abs(signature) ** 2, axis=0)
        sums, norms = (np.zeros((self.n_hypotheses(block.setup), 2)) for _ in range(2))
        sums[block.bls] = np.stack([told.real, sense_of(block.setup)[block.bls] * told.imag], axis=-1)
        norms[block.bls] = power[:, np.newaxis]
        return sums, norms

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        """Return the effect on these baselines; ``hypotheses`` is (Nchosen,)."""
        return type(self)(setup.observation.antpairs[hypotheses].tolist())

    def _places(self, setup: ObservingSetup) -> IntArray:
        """Return the index of each baseline; the observation must have it."""
        pairs = np.sort(setup.observation.antpairs, axis=1)
        asked = np.sort(np.array(self.baselines, dtype=int).reshape(-1, 2), axis=1)
        size = int(max(pairs.max(), asked.max(initial=0))) + 1
        known, wanted = pairs @ [size, 1], asked @ [size, 1]
        order = np.argsort(known)
        places = order[np.searchsorted(known, wanted, sorter=order).clip(max=len(known) - 1)]
        lacking = np.flatnonzero(known[places] != wanted)
        if len(lacking):
            one, two = self.baselines[lacking[0]]
            raise InputError(
                f"no baseline {one}-{two} in the data", field="baselines", remedy="name pairs of antennas that are"
            )
        if len(np.unique(places)) < len(places):
            raise InputError("a baseline is named twice", field="baselines", remedy="name each once, in either order")
        return places


def sense_of(setup: ObservingSetup) -> FloatArray:
    """Return 1 for baselines that the data have in the sense of their group, and -1 for others, (Nbls,)."""
    return np.where(setup.redundant.flipped, -1.0, 1.0)
