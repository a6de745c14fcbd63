"""The last check before a result is written: all its numbers are finite."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hydrabeam_mpi.errors import InputError

SIMULATION = "lower the fluxes of [sky], [data.simulate.perturb], or the effects in [[data.simulate.effects]]"
INFERENCE = "compare [noise], [prior] and [sky] with the data: something in them is too large or too small by far"
MODEL = "mend the beam of [beam] source, or choose another"


def check_finite(where: str, numbers: Mapping[str, Any], remedy: str) -> None:
    """Make sure that all numbers are finite.

    Parameters
    ----------
    where : str
        Which channel, or which file.
    numbers : mapping
        By name: arrays, numbers, or lists and mappings of them; what is no number is passed over.
    remedy : str
        What most likely mends it.

    Raises
    ------
    InputError
        If a number is NaN or infinite; names the first.
    """
    for name, values in _leaves(numbers):
        finite = np.isfinite(values)
        if not finite.all():
            count = f"{np.count_nonzero(~finite)} of {finite.size} numbers are" if finite.size > 1 else "is"
            message = f"{name}: {count} not finite, so nothing is written"
            raise InputError(message, field=where, remedy=remedy)


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield numbers and arrays of numbers with their names."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{name} {key}".strip())
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _leaves(item, name)
    elif isinstance(value, float | complex | np.ndarray) and np.asarray(value).dtype.kind in "fc":
        yield name, value
