"""What of a rank's rows there is room to keep, so that it is not made anew in each pass over them."""

from __future__ import annotations

from dataclasses import dataclass

from hydrabeam_mpi.mpi import Comm, memory_per_rank

KEPT_BYTES = 2_000_000_000
"""The design of fitted rows, and that of held-out ones, is kept where it takes no more, if nothing is known of how much
memory there is; else it is made anew in each pass."""
PART_KEPT = 0.25
"""The same as a part of the memory that a rank has: the two take half of it at most."""
REAL, COMPLEX = 8, 16
SKIES_ELSEWHERE = 6
"""Displaced skies that are kept: those of two steps of a fit with a clock, an orientation and refraction."""


def bytes_to_keep(world: Comm) -> float:
    """Return how much of the memory of a rank either design may take. Collective: all ranks of `world`."""
    return PART_KEPT * memory_per_rank(world)


@dataclass(frozen=True)
class Room:
    """What of some rows is kept.

    Attributes
    ----------
    designs : bool
        The design, and what effects integrate over the sky.
    places : bool
        Where the sources are at each time.
    waves : bool
        Their fringes, too.
    skies_elsewhere : int
        The same of so many skies of a channel that are displaced.
    """

    designs: bool
    places: bool
    waves: bool
    skies_elsewhere: int

    @classmethod
    def of(cls, n_times: int, n_groups: int, n_channels: int, n_modes: int, n_sources: int, kept_bytes: float) -> Room:
        """Decide by the sizes of a rank's rows, of which those of one channel have ``n_times n_groups`` designs."""
        n_designs = n_times * n_groups * n_channels
        n_places = n_sources * n_times
        places = 3 * REAL * n_places <= kept_bytes / 4
        # Of the sources half are above the horizon.
        of_waves = REAL * n_places * n_groups * n_channels
        waves = places and of_waves <= kept_bytes / 4
        elsewhere = SKIES_ELSEWHERE if waves and (1 + SKIES_ELSEWHERE) * of_waves <= kept_bytes / 4 else 0
        # Those of the sky as it is, and as it is with effects.
        return cls(2 * COMPLEX * n_designs * n_modes <= kept_bytes, places, waves, elsewhere)
