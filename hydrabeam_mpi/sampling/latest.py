"""What a chain has worked out for where it is and for where it is thinking of going."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


N_KEPT = 3
"""Where a chain is, where it is thinking of going, and, of several channels, where some of them have gone."""


class Latest:
    """What has been worked out last, for where a chain is and for where it is thinking of going."""

    def __init__(self) -> None:
        self._kept: dict[bytes, object] = {}

    def of(self, key: bytes, make: Callable[[], T]) -> T:
        """Return what ``make`` gives for a key."""
        found = self._kept.pop(key) if key in self._kept else make()
        self._kept[key] = found
        while len(self._kept) > N_KEPT:
            del self._kept[next(iter(self._kept))]
        return found  # type: ignore[return-value]
