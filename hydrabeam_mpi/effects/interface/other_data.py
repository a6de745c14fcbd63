"""What of an effect holds in other data than those in which it was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Self

from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup


class InOtherData:
    """An effect's word on other data of the same array and sky.

    Parameters are told apart by their names, which have the antenna, baseline, source or time in them: what was found
    of an antenna holds for the antenna of that number, wherever it stands among the others, and what was found of a
    single time holds at that time alone.
    """

    local: Literal["times", "baselines"] | None = None
    """Whether each parameter belongs to a single time or baseline, so that other rows do not constrain it."""
    of_the_sky: bool = False
    """Whether it is the sky that differs, which data from which the instrument's effects are taken out still show."""
    of_both_feeds: bool = False
    """Whether both feeds of an element have it, as they have what is of the sky."""

    def carried_over(self, setup: ObservingSetup) -> Self | str:
        """Return the effect with those of its elements that other data have, or say why it does not hold in them."""
        return self

    def anew(self, setup: ObservingSetup) -> tuple[Self, Mapping[str, Mapping[str, float]]] | None:
        """Return what other data have of an effect that is there, too, but not as it was found.

        With it come, for the name of each of its parameters, the names of those whose prior says how large it may be,
        with what their variances count in its own.
        """
        return None

    def known_as(self, names: Sequence[str]) -> dict[str, tuple[int, float]]:
        """Return number and sign of each parameter by all names that it has in any data; ``names`` are those here."""
        return {name: (number, 1.0) for number, name in enumerate(names)}
