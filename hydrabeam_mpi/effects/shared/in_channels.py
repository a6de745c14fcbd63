"""Effects of which each channel may have parameters of its own, or all channels the same."""

from __future__ import annotations

from typing import Any, Literal, Self

from hydrabeam_mpi.effects.interface.effect import Effect

Channels = Literal["each", "alike"]


class InChannels(Effect):
    """An effect in two forms: each channel has its own parameters, or all have the same.

    An amplifier, a reflector or a feed that is off is so over some MHz, and takes no more parameters then than one
    channel has. What calibration does in each channel by itself is each channel's own.

    Parameters
    ----------
    channels : {"each", "alike"}
        Whether each channel has parameters of its own, or all have the same.
    """

    def __init__(self, channels: Channels = "each") -> None:
        self.shared = channels == "alike"
        self.title = self._as_in_channels(self.title)

    def describe(self) -> dict[str, Any]:
        """Return whether all channels are alike, where they are."""
        return {"channels": "alike"} if self.shared else {}

    def same_in_all_channels(self) -> Self | None:
        """Return the form in which all channels have the same."""
        return None if self.shared else type(self)("alike")

    def title_in_time(self, law: str) -> str:
        """Return what the effect is called where it changes by a law, and whether alike in all channels."""
        return self._as_in_channels(super().title_in_time(law))

    def _as_in_channels(self, title: str) -> str:
        return f"{title}, the same in all channels" if self.shared else title
