"""Where the sources are at one time, and what is kept of that for as long as there is room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.model.engines.base import Engine
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.rime import Beam

SkyEffects = Sequence[tuple[Any, FloatArray]]
"""Effects that change the sky, with their parameters."""


@dataclass
class Place:
    """The sources above the horizon at one time.

    Attributes
    ----------
    index : ndarray of int, (Nsrc,)
        Which of the sky's sources.
    za, az : ndarray, (Nsrc,)
        Radians.
    """

    index: IntArray
    za: FloatArray
    az: FloatArray
    _flux: dict[int, FloatArray] = field(default_factory=dict)
    _seen: dict[int, list[tuple[Beam, SkyEffects, Sources]]] = field(default_factory=dict)
    _waves: dict[int, FloatArray] = field(default_factory=dict)

    @cached_property
    def enu(self) -> FloatArray:
        """Unit vectors, (3, Nsrc)."""
        return enu(self.za, self.az)

    def flux(self, channel: int, of_all: FloatArray) -> FloatArray:
        """Return their fluxes in a channel, (Nsrc,), of those of the sky's sources in all channels, (Nfreqs, Nall)."""
        if channel not in self._flux:
            self._flux[channel] = of_all[channel, self.index]
        return self._flux[channel]

    def waves(self, channel: int, engine: Engine, freq: float) -> FloatArray:
        """Return real parts, then imaginary ones, of the fringes of an engine's vectors, (2 Nvectors, Nsrc)."""
        if channel not in self._waves:
            made = np.empty((2, engine.n_vectors, len(self.za)))
            engine.fringes.fill(made, self.enu, np.ones(len(self.za)), freq)
            self._waves[channel] = made.reshape(2 * engine.n_vectors, -1)
        return self._waves[channel]

    def seen(self, channel: int, beam: Beam, sky_effects: SkyEffects) -> Sources | None:
        """Return the sources as they were seen lately, where that was by the same beam and with the same effects."""
        for known_beam, known_effects, sources in self._seen.get(channel, []):
            if beam is known_beam and _are_same(known_effects, sky_effects):
                return sources
        return None

    def keep(self, channel: int, beam: Beam, sky_effects: SkyEffects, sources: Sources) -> None:
        """Keep the sources as a beam sees them with effects, and as the one before, which may be its other part."""
        self._seen[channel] = [(beam, sky_effects, sources), *self._seen.get(channel, [])[:1]]


@dataclass
class PlacesElsewhere:
    """Where sources are in skies that effects displace, of the latest such skies: those of a fit's last steps.

    Attributes
    ----------
    most : int
        Skies of a channel that are kept at most; none where there is no room.
    """

    most: int = 0
    _latest: dict[int, list[tuple[dict[int, Place], Any, FloatArray, dict[int, Place]]]] = field(default_factory=dict)

    def of(self, channel: int, before: dict[int, Place], effect: Any, x: FloatArray) -> dict[int, Place]:
        """Return the places of a sky that an effect displaces by parameters ``x``, to be filled in, by time.

        ``before`` are those of the sky without it, the very object.
        """
        latest = self._latest.setdefault(channel, [])
        for number, (known, by, at, places) in enumerate(latest):
            if known is before and by is effect and np.array_equal(at, x):
                latest.append(latest.pop(number))
                return places
        latest.append((before, effect, x.copy(), {}))
        found = latest[-1][-1]
        del latest[: max(len(latest) - self.most, 0)]
        return found


def _are_same(one: SkyEffects, two: SkyEffects) -> bool:
    return len(one) == len(two) and all(
        first is second and np.array_equal(x, y) for (first, x), (second, y) in zip(one, two, strict=True)
    )
