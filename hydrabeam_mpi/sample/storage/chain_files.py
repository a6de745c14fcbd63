"""The files of one chain: which of them are whole, and what is left by kills, merges and damage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.sample.storage.segment import Segment
from hydrabeam_mpi.sample.storage.whole_file import is_whole

T = TypeVar("T")
ASIDE = "set_aside"
"""Folder for what is damaged, and for draws that come after it."""
TRIES = 100
"""A reader begins anew so often where a chain that grows puts its files together under it."""


@dataclass
class ChainFiles:
    """The files of one chain.

    Attributes
    ----------
    folder : Path
    chain : int
    """

    folder: Path
    chain: int
    _whole: dict[tuple[Path, int, int, int], bool] = field(default_factory=dict)

    def segments(self) -> list[Segment]:
        """List the segments that are whole, from the first draw on without a gap."""
        return self.look()[0]

    def look(self) -> tuple[list[Segment], Segment | None]:
        """List the segments that are whole, from the first draw on, and find the first one that is not used for that.

        Where small segments have been merged and are still there the largest that is whole counts.
        """
        return retried(self._look)

    def _look(self) -> tuple[list[Segment], Segment | None]:
        found = self.all_segments()
        whole: list[Segment] = []
        end = 0
        while True:
            here = [one for one in found if one.first == end and self._is_whole(one)]
            if not here:
                break
            whole.append(max(here, key=lambda one: one.end))
            end = whole[-1].end
        return whole, next((one for one in found if one.end > end), None)

    def all_segments(self) -> list[Segment]:
        """List all segments, whole or not, in the order of their draws."""
        if not self.folder.is_dir():
            return []
        named = (Segment.named(path) for path in self.folder.iterdir())
        return sorted((one for one in named if one is not None), key=lambda one: (one.first, one.end))

    def caution(self) -> str | None:
        """Say in a line what is damaged, if anything is."""
        whole, bad = self.look()
        if bad is None:
            return None
        n = whole[-1].end if whole else 0
        what = "is truncated or damaged" if bad.first == n else f"has no draw {n} before it"
        return f"{bad.path}: {what}: of chain {self.chain} the first {n} draws are kept, which are whole"

    def tidy(self) -> None:
        """Remove what a killed process has left, and set aside what is damaged and what comes after it."""
        whole, bad = self.look()
        for path in self.folder.glob(".*.partial-*"):
            path.unlink(missing_ok=True)
        end = whole[-1].end if whole else 0
        for one in self.all_segments():
            if one.end > end or (bad and not self._is_whole(one)):
                aside = self.folder / ASIDE
                aside.mkdir(exist_ok=True)
                one.path.replace(aside / one.path.name)
            elif one not in whole:
                one.path.unlink(missing_ok=True)

    def _is_whole(self, segment: Segment) -> bool:
        """Check a file once, unless it changes."""
        about = segment.path.stat()
        key = segment.path, about.st_size, about.st_mtime_ns, about.st_ino
        if key not in self._whole:
            self._whole[key] = is_whole(segment.path)
        return self._whole[key]


def retried(read: Callable[[], T]) -> T:
    """Read again where a file goes meanwhile, as small ones do that are put together.

    Raises
    ------
    InputError
        If that does not end.
    """
    for _ in range(TRIES):
        try:
            return read()
        except FileNotFoundError as error:
            gone = error
    raise InputError("was removed while it was read", file=gone.filename, remedy="try again") from gone
