"""What takes long to make, and is made once where there is room to keep it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Kept(Generic[T]):
    """A series of things that are made one after the other; of the latest key.

    Parameters
    ----------
    has_room : bool
        Whether they are kept, or made anew each time.
    """

    def __init__(self, has_room: bool) -> None:
        self._has_room = has_room
        self._key: object = None
        self._made: list[T] | None = None

    def of(self, key: object, make: Callable[[], Iterable[T]]) -> Iterator[T]:
        """Yield what ``make`` gives for a key."""
        if self._made is not None and key == self._key:
            yield from self._made
            return
        self._made, made = None, []
        for one in make():
            if self._has_room:
                made.append(one)
            yield one
        if self._has_room:
            self._made, self._key = made, key
