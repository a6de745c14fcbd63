"""Linear bases for a beam: one small interface, whatever the functions are.

A beam is ``B(za, az) = sum_n b_n f_n(za, az)``. Everything downstream (the design matrix, the fit, the
posterior) knows a basis only through :class:`LinearBasis`. Functions are evaluated as *real columns*, because
a real matrix halves the work of every product with it; a complex basis says with ``mix`` how its functions
follow from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.errors import InputError

FloatArray = NDArray[np.float64]
# float64 or complex128
Array = NDArray[Any]


class LinearBasis(Protocol):
    """What a set of beam functions must be able to do.

    A new basis derives from this class and supplies the attributes, ``columns`` and ``describe``; the other
    methods have defaults that are right for a real basis.

    Attributes
    ----------
    n_modes : int
        Number of functions, that is of coefficients.
    is_complex : bool
        Whether coefficients are complex.
    n_columns : int
        Number of real columns from which the functions are mixed.
    """

    n_modes: int
    is_complex: bool
    n_columns: int

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the real columns.

        Parameters
        ----------
        za, az : ndarray, (Npoints,)
            Zenith angle, and azimuth from East through North, in radians.
        out : ndarray, (n_columns, Npoints), optional
            Where to put the result; its rows must be contiguous.

        Returns
        -------
        ndarray, (n_columns, Npoints)
            ``out``, or a new array that nothing else refers to.
        """
        ...

    def describe(self) -> dict[str, Any]:
        """Return a JSON-able description from which :func:`basis_from_description` restores the basis."""
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


# Points evaluated together: few enough to stay in cache, enough to hide the cost of a call.
_POINTS_AT_ONCE = 2048


def basis_from_description(description: Mapping[str, Any]) -> LinearBasis:
    """Restore a basis from what its ``describe`` returned.

    Raises
    ------
    InputError
        If the description is of no known kind or incomplete.
    """
    from hydrabeam_mpi.model.fourier_bessel import FourierBessel
    from hydrabeam_mpi.model.zernike import Zernike

    makers = {"fourier_bessel": FourierBessel.from_description, "zernike": Zernike.from_description}
    kind = description.get("kind")
    if kind not in makers:
        raise InputError(f"unknown basis kind {kind!r}", field="basis", remedy=f"known: {', '.join(makers)}")
    try:
        return makers[kind](description)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"incomplete description of a {kind} basis: {error!r}", field="basis") from error
