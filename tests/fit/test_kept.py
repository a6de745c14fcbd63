"""What is kept is made once for a key, and anew where there is no room."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hydrabeam_mpi.fit.kept import Kept


@pytest.mark.parametrize("has_room", [True, False])
def test_things_are_made_once_where_there_is_room(has_room: bool) -> None:
    made: list[tuple[str, int]] = []

    def make(key: str) -> Iterator[int]:
        for number in range(3):
            made.append((key, number))
            yield number

    kept: Kept[int] = Kept(has_room)
    for key in ("one", "one", "two", "one"):
        assert list(kept.of(key, lambda key=key: make(key))) == [0, 1, 2]  # type: ignore[misc]
    assert len(made) == 3 * (3 if has_room else 4)


def test_what_was_not_made_to_the_end_is_not_kept() -> None:
    kept: Kept[int] = Kept(has_room=True)
    assert next(kept.of(None, lambda: iter(range(3)))) == 0
    assert list(kept.of(None, lambda: iter(range(3)))) == [0, 1, 2]
