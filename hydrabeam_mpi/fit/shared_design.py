"""The design of several polarisations, the sums over sources of which are computed once.

What a baseline sees of a real function on its reverse is the conjugate. So co-polarised rows, in which a baseline and
its reverse are one, and cross-polarised ones, in which they are two, follow from the same sums.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray, IntArray
from hydrabeam_mpi.fit.accumulate import mixed
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.model.bases.shared import SharedBasis
from hydrabeam_mpi.model.engines.base import Precision
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.progress import track


def leader(problems: Sequence[Problem]) -> int:
    """Return the number of the problem with the fewest groups of baselines, of which those of all others are parts."""
    return next((number for number, one in enumerate(problems) if one.observation.is_copolar), 0)


class SharedDesign:
    """The design of each time in all polarisations.

    Parameters
    ----------
    problems : sequence of Problem
        Of the rank group's channels; they differ in the polarisation alone, and in what follows from that.
    rows : sequence of Rows
        The same tile in each.
    precision : type
        See `ForwardModel`.
    """

    def __init__(self, problems: Sequence[Problem], rows: Sequence[Rows], precision: Precision = np.float64) -> None:
        first = leader(problems)
        self._times = rows[first].tile.times
        self._model = problems[first].forward_model(rows[first].groups, precision)
        self._basis = SharedBasis([problem.basis for problem in problems])
        flipped = problems[first].redundant.flipped
        self._groups = [
            _places(rows[first], one, flipped != problem.redundant.flipped)
            for problem, one in zip(problems, rows, strict=True)
        ]

    def by_time(self, label: str, show: bool) -> Iterator[tuple[int, list[Array]]]:
        """Yield the number of each time with the polarisations' designs, as the function `designs` gives them."""
        whole = self._basis.basis
        by_time = track(self._model.design_columns(whole, self._times), len(self._times), label, show)
        for t, parts in enumerate(by_time):
            yield (
                t,
                [
                    self._basis.taken(number, mixed(whole, _seen(parts, *groups)))
                    for number, groups in enumerate(self._groups)
                ],
            )


def _places(first: Rows, rows: Rows, turned: BoolArray) -> tuple[IntArray, BoolArray]:
    """Return of which of the first rows' groups each group is, and whether it points the other way, (Nlocal,) each.

    ``turned``, (Nbls,), tells which baselines do.
    """
    place, reverse = np.empty(len(rows.groups), dtype=int), np.empty(len(rows.groups), dtype=bool)
    place[rows.member], reverse[rows.member] = first.member, turned[rows.tile.bls]
    return place, reverse


def _seen(parts: FloatArray, place: IntArray, reverse: BoolArray) -> FloatArray:
    """Return the design of the real columns, (Nfreqs, 2, Nlocal, n_columns), for other groups than it was made for."""
    if not reverse.any() and np.array_equal(place, np.arange(parts.shape[2])):
        return parts
    seen = parts[:, :, place]
    seen[:, 1, reverse] *= -1
    return seen
