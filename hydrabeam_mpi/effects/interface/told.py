"""What people are told of an effect's parameters."""

from __future__ import annotations

from dataclasses import dataclass

from hydrabeam_mpi.data.observation import BoolArray, FloatArray


@dataclass(frozen=True)
class Told:
    """Fitted parameters as they are told to people, such as a place on the sky rather than an offset from a grid.

    Attributes
    ----------
    names, units : tuple of str
    values, std : ndarray, (Nfreqs, n_params)
    from_zero : ndarray of bool, (n_params,)
        Whether zero is what is expected without the effect, as it is not of a place.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    std: FloatArray
    from_zero: BoolArray
