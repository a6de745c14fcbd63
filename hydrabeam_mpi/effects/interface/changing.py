"""What an effect says of changes in time, by which it may be looked for beside what is constant."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.parameters import Parameters
from hydrabeam_mpi.effects.interface.row_block import RowBlock

T = TypeVar("T")


class Undecided(NamedTuple, Generic[T]):
    """What the fitted times do not tell of an effect: it, and ``others``, are alike at all but some ``times``.

    These are numbers of the observation's, (n_times,), none of them fitted.
    """

    times: IntArray
    others: list[T]


class MayChange:
    """Something with parameters that may change in time; see `hydrabeam_mpi.effects.shared.in_time`."""

    laws: ClassVar[Mapping[str, str]] = {}
    """Laws by which its parameters may change in time, and what it is called then.

    Which parameters columns belong to must be the same at all times, and what is multiplied must be linear.
    """

    @abstractmethod
    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the parameters."""

    def title_in_time(self, law: str) -> str:
        """Return what it is called where its parameters change by a law."""
        return self.laws[law]

    def changing(self, law: Any) -> MayChange | None:
        """Return what changes by a law in time where not all of its parameters do; None where they do."""
        return None

    def undecidable_in_time(self, setup: ObservingSetup) -> FloatArray:
        """Return those of the `degenerate_directions` that no data can tell even if they change in time, (n, n_params).

        The others are not degenerate then, as the beam is the same at all times.
        """
        return np.zeros((0, len(self.parameters(setup))))

    def common_in_time(self, setup: ObservingSetup) -> tuple[tuple[str, ...], FloatArray]:
        """Return the other ones as numbers of their own, which may change where nothing else does.

        Their names, (n,), and by how much each of the parameters goes with them, (n, n_params).
        """
        return (), np.zeros((0, len(self.parameters(setup))))

    def alternatives(self, setup: ObservingSetup, used: IntArray) -> list[Undecided[Self]]:
        """Return effects with the same parameters that differ from this one in nothing but times that are not fitted.

        Of each function of time those that have another in its place. The numbers of the parameters in use are
        (n_used,).
        """
        return []


class ScannedInTime:
    """Something with candidates that are scanned one by one, and that may change in time."""

    functions_in_time: ClassVar[int] = 4
    """Functions of time with which each candidate, such as a baseline, is looked at: two swings, in each night that has
    its own. The more functions each has, the fewer are weighed together."""

    @abstractmethod
    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Return the sums of every candidate, each (n_hypotheses, p)."""

    def scan_in_time(self, block: RowBlock, functions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sums of `scan` with each of some functions of time, (Ntimes, k), in s: (n_hypotheses, k p)."""
        found = []
        for function in functions.T[:, :, np.newaxis]:
            over = np.divide(1.0, function, out=np.zeros_like(function), where=function != 0)
            weights, residual = block.weights * function**2, block.residual * over
            found.append(self.scan(replace(block, weights=weights, residual=residual)))
        sums, norms = zip(*found, strict=True)
        return np.concatenate(sums, axis=1), np.concatenate(norms, axis=1)
