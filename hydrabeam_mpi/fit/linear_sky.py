"""The design of a rank's rows as a function of the sky's parameters, where it is linear in these.

    A(x) = A_0 + sum_k x_k A_k

holds for fluxes and for harmonics, whose A_k are worked out once. A chain asks for thousands of skies; each is then a
sum of what is there, whereas diffuse emission alone is an integral over the whole sky.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.state import Values

LINEAR_RTOL = 1e-10
"""By how much of the largest change of a design the sum may miss it: what rounding leaves, and no bend."""


@dataclass(frozen=True)
class LinearSky:
    """Design rows for each sky of some effects.

    Attributes
    ----------
    fixed : bytes
        What tells the rest of the sky.
    moving : tuple of int
        Places of the effects among those of the model.
    base : ndarray, (Nlocal, Ntimes, ...)
        A_0.
    slopes : ndarray, (Nlocal, q, Ntimes, ...)
        A_k of their parameters in use, side by side.
    channels : ndarray of int, (Nlocal,)
    """

    fixed: bytes
    moving: tuple[int, ...]
    base: Array
    slopes: Array
    channels: Sequence[int]

    def has(self, values: Values) -> bool:
        """Whether the rest of the sky is as it was."""
        return _fixed(values, self.moving) == self.fixed

    def designs(self, values: Values) -> Iterator[Array]:
        """Yield the design of each time, (Nlocal, ...)."""
        x = _in_use(values, self.moving)[list(self.channels)]
        total = [
            base + np.tensordot(one, slope, axes=1) for base, one, slope in zip(self.base, x, self.slopes, strict=True)
        ]
        yield from (np.array(parts) for parts in zip(*total, strict=True))


def linear_sky(
    designs: Callable[[Values], Iterable[Array]], values: Values, moving: Sequence[int], channels: Sequence[int]
) -> LinearSky | None:
    """Return what the design rows of all skies follow from; None where they are not linear in the parameters. Serial.

    Parameters
    ----------
    designs : callable
        Gives the design of each time, (Nlocal, ...).
    values : Values
    moving : sequence of int
        Places of the effects that change the sky and move.
    channels : sequence of int
        The rank group's.
    """
    places = tuple(moving)

    def at(numbers: FloatArray) -> Array:
        changed = _with_in_use(values, places, np.broadcast_to(numbers, (len(values.x), len(numbers))))
        return np.stack(list(designs(changed)), axis=1)

    width = np.concatenate([values.active[place].prior.of(0).std() for place in places])
    base = at(np.zeros(len(width)))
    slopes = np.empty((len(base), len(width), *base.shape[1:]), dtype=base.dtype)
    for k, one in enumerate(width):
        slopes[:, k] = (at(one * np.eye(len(width))[k]) - base) / one
    # Signs in turn: of two that multiply each other neither may be zero.
    tried = width * (-1.0) ** np.arange(len(width))
    change = at(tried) - base
    bend = np.abs(change - np.tensordot(tried, slopes, axes=(0, 1))).max(initial=0.0)
    if bend > LINEAR_RTOL * np.abs(base).max(initial=0.0):
        return None
    return LinearSky(_fixed(values, places), places, base, slopes, channels)


def _in_use(values: Values, places: Sequence[int]) -> FloatArray:
    """Return the parameters in use of some effects, side by side, (Nfreqs, q)."""
    return np.concatenate([values.active[place].x[:, values.active[place].used] for place in places], axis=1)


def _with_in_use(values: Values, places: Sequence[int], x: FloatArray) -> Values:
    """Return the effects with others of these parameters, (Nfreqs, q)."""
    whole = values.x.copy()
    whole[:, np.concatenate([np.r_[values.spans[place]] for place in places])] = x
    return values.at(whole)


def _fixed(values: Values, places: Sequence[int]) -> bytes:
    """Return what tells the effects that change the sky and do not move."""
    others = [one for place, one in enumerate(values.active) if place not in places and one.effect.changes_sky]
    return b"".join(one.x.tobytes() for one in others)
