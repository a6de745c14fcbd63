"""One basis in place of several, so that what all of them see of the sky is computed once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.joined import join


class SharedBasis:
    """The functions of several bases, each function once.

    Parameters
    ----------
    bases : sequence of LinearBasis

    Attributes
    ----------
    basis : LinearBasis
        All functions.
    """

    def __init__(self, bases: Sequence[LinearBasis]) -> None:
        self.basis = bases[0]
        self._places: list[list[int]] = []
        for one in bases:
            found = self.basis.united(one)
            if found is None:
                places = range(self.basis.n_modes, self.basis.n_modes + one.n_modes)
                found = join([self.basis, one]), list(places)
            self.basis, places_of_one = found
            self._places.append(places_of_one)

    def taken(self, number: int, rows: Array) -> Array:
        """Return what belongs to one of the bases, (..., n_modes), out of rows of all functions, (..., all modes)."""
        places = self._places[number]
        return rows if places == list(range(self.basis.n_modes)) else np.take(rows, places, axis=-1)
