"""Linear bases for a beam: one small interface, whatever the functions are.

A beam is ``B(za, az) = sum_n b_n f_n(za, az)``. Everything downstream (the design matrix, the fit, the
posterior) knows a basis only through :class:`LinearBasis`. Functions are evaluated as *real columns*, because
a real matrix halves the work of every product with it; a complex basis says with ``mix`` how its functions
follow from them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray, IntArray
from hydrabeam_mpi.model.bases.polar_table import PolarTable
from hydrabeam_mpi.model.bases.rings import RingGrid

NEGLIGIBLE = 1e-9
"""Coefficients below this fraction of the largest are rounding errors."""


def has_part(amplitudes: FloatArray) -> BoolArray:
    """Return in which functions a beam of these amplitudes has a part, more than rounding errors, both (n_modes,)."""
    return np.asarray(amplitudes > NEGLIGIBLE * amplitudes.max())


@dataclass(frozen=True)
class Selection:
    """A number of modes to be selected from a basis by a beam's coefficients.

    Attributes
    ----------
    basis : LinearBasis
        All modes that there are to choose from.
    n_modes : int or None
        Number of modes kept, those whose coefficients are largest; None keeps all.
    rest : bool
        Whether all that a real beam has beyond these is kept as one more function.
    """

    basis: LinearBasis
    n_modes: int | None
    rest: bool = False


@dataclass(frozen=True)
class NextModes:
    """The functions that a basis would have next; real, whatever the form of the basis.

    Attributes
    ----------
    modes : tuple of (int, int)
        Their numbers, by which they are called.
    expected : ndarray, (len(modes),)
        How large their coefficients are expected to be, by those of the model beam.
    make : callable
        Makes the basis of these functions.
    n_beyond : int
        How many of them, the first, are beyond what any number of functions of the basis's own kind can follow.
    """

    modes: tuple[tuple[int, int], ...]
    expected: FloatArray
    make: Callable[[], LinearBasis]
    n_beyond: int = 0

    @cached_property
    def basis(self) -> LinearBasis:
        """These functions, real."""
        return self.make()


class LinearBasis(Protocol):
    """What a set of beam functions must be able to do.

    A new basis has a module of its own beside this one and a line in `BASES`. It derives from this class and supplies
    the attributes, ``columns`` and how it is made and described; the other methods have defaults that are right for a
    real basis of which nothing more is known.

    Attributes
    ----------
    title : str
        What its functions are called.
    n_modes : int
        Number of functions, that is of coefficients.
    is_complex : bool
        Whether coefficients are complex.
    n_columns : int
        Number of real columns from which the functions are mixed.
    """

    title: ClassVar[str] = "linear"
    n_modes: int
    is_complex: bool
    n_columns: int

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> LinearBasis | Selection:
        """Make the basis that a job asks for, or say from which to select modes by the model beam.

        Parameters
        ----------
        settings : mapping
            Keys and values of the job's ``[basis]`` table.
        """
        ...

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Self:
        """Restore a basis from what ``describe`` returned; KeyError where that is incomplete."""
        ...

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the real columns.

        Parameters
        ----------
        za, az : ndarray, (Npoints,)
            Zenith angle, and azimuth from East through North, in radians.
        out : ndarray, (n_columns, Npoints), optional
            Where to put the result, in double or in single precision; its rows must be contiguous.

        Returns
        -------
        ndarray, (n_columns, Npoints)
            ``out``, or a new array that nothing else refers to.
        """
        ...

    def describe(self) -> dict[str, Any]:
        """Return a JSON-able description from which ``from_description`` restores the basis, with its ``kind``."""
        ...

    def mix(self, rows: Array) -> Array:
        """Turn columns into functions, along the last axis.

        Linear in ``rows``: for the real columns C of some points, ``mix(C.T)`` is the matrix of the f_n
        there, and for any matrix X, ``mix(X @ C.T) = X @ mix(C.T)``. The identity for a real basis.

        Parameters
        ----------
        rows : ndarray, (..., n_columns)

        Returns
        -------
        ndarray, (..., n_modes)
        """
        return rows

    def column_coeffs(self, coeffs: Array) -> Array:
        """Return the coefficients c of the columns that give the same beam.

        ``column_coeffs(b) @ columns(za, az) = b @ evaluate(za, az)``.

        Parameters
        ----------
        coeffs : ndarray, (..., n_modes)

        Returns
        -------
        ndarray, (..., n_columns)
        """
        return coeffs

    def amplitudes(self, coeffs: Array) -> FloatArray:
        """Return how large each coefficient is, for a prior width that is a fraction of it, (n_modes,)."""
        return np.abs(coeffs)

    def expected(self, amplitudes: FloatArray) -> FloatArray:
        """Return how large coefficients may be by those of a model beam, (n_modes,), ``amplitudes`` and result alike.

        A model is never so exact that what it has no part in is zero: a round one says nothing of how a beam varies
        with azimuth. A basis that knows which functions are near each other tells what to expect of those from others.
        """
        return amplitudes

    @property
    def orders(self) -> IntArray:
        """Radial and azimuthal order of each function from zero on, (n_modes, 2); zero where nothing is known."""
        return np.zeros((self.n_modes, 2), dtype=int)

    def largest(self, amplitudes: FloatArray, n_modes: int) -> LinearBasis:
        """Return the basis of the modes with the largest coefficients; all of them where these go together.

        Parameters
        ----------
        amplitudes : ndarray, (n_modes of this basis,)
        n_modes : int
            Most modes to keep.
        """
        return self

    def next_modes(self, amplitudes: FloatArray, n_before: int, most: int) -> NextModes | None:
        """Return the functions that the basis would have next, or None where that is not known.

        Parameters
        ----------
        amplitudes : ndarray, (n_modes,)
            How large the model beam's coefficients are.
        n_before : int
            How many of them others have taken.
        most : int
            Most functions to return.
        """
        return None

    @property
    def n_rings(self) -> int:
        """Number of zenith angles at which a beam must have samples for its functions to be told apart, if any."""
        return 0

    def fit_rings(self, rings: RingGrid) -> tuple[Array, int] | None:
        """Fit samples on rings of equal zenith angle, where these give a faster or a better fit than points.

        Parameters
        ----------
        rings : RingGrid

        Returns
        -------
        tuple of ndarray, (..., n_modes), and int, or None
            Coefficients, of as many beams as the rings have values of, and how many directions of coefficient space the
            samples do not determine; None where rings are no better than points.
        """
        return None

    def evaluate(self, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the functions f_n, (n_modes, Npoints)."""
        return self.mix(self.columns(za, az).T).T

    def synthesize(self, coeffs: Array, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the beam ``sum_n b_n f_n``, (Npoints,), without holding all columns of all points.

        Parameters
        ----------
        coeffs : ndarray, (n_modes,)
        za, az : ndarray, (Npoints,)
            Radians.
        """
        weights = self.column_coeffs(coeffs)
        values = np.empty(np.shape(za), dtype=weights.dtype)
        for start in range(0, len(values), _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            values[part] = weights @ self.columns(za[part], az[part])
        return values

    def united(self, other: LinearBasis) -> tuple[LinearBasis, list[int]] | None:
        """Return the basis of one's own functions and then those that another one has besides.

        Also where all of the other's functions are in it. None where it is not of the same kind.
        """
        return (self, list(range(self.n_modes))) if self.describe() == other.describe() else None

    def with_more(self, other: LinearBasis) -> LinearBasis | None:
        """Return the basis of one's own functions and then those of another one, where it is of the same kind.

        None where both have one in common.
        """
        both = self.united(other)
        return both[0] if both and both[0].n_modes == self.n_modes + other.n_modes else None

    def table(self, coeffs: Array) -> PolarTable | None:
        """Return a table of the real part of the beam, by which it and its slopes are cheap at many points.

        None where the basis offers none. It goes as far as the horizon.

        Parameters
        ----------
        coeffs : ndarray, (n_modes,)
        """
        if self.table_nodes is None:
            return None
        per_unit, n_az = self.table_nodes
        return PolarTable(self.at_nodes(coeffs, per_unit, n_az), per_unit, self.through_zenith)

    @property
    def through_zenith(self) -> bool:
        """Whether all functions are smooth at the zenith; see `PolarTable`."""
        return False

    @property
    def table_nodes(self) -> tuple[int, int] | None:
        """Radial nodes per unit and azimuths that a table needs (see `PolarTable`); None where there can be none."""
        return None

    def at_nodes(self, coeffs: Array, per_unit: int, n_az: int) -> FloatArray:
        """Return the real part of the beam, with coefficients (n_modes,), at a table's nodes, (Nradii, Naz)."""
        raise ValueError(f"{self.title} bases have no table")


# Points evaluated together: few enough to stay in cache, enough to hide the cost of a call.
_POINTS_AT_ONCE = 2048
