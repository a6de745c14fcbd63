"""The files of one chain: which of them are whole, and what is left by kills, merges and damage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.sampling.storage.segment import Segment, read_segment, remains_of, write_segment
from hydrabeam_mpi.sampling.storage.variable import Variable
from hydrabeam_mpi.sampling.storage.whole_file import is_whole

T = TypeVar("T")
ASIDE = "set_aside"
"""Folder for what is damaged, and for draws that come after the damage."""
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
    _seen: dict[tuple[Path, int, int, int], Segment | None] = field(default_factory=dict)

    def segments(self) -> list[Segment]:
        """List the segments from the first draw on without a gap; of the first damaged one what is before the damage.

        Where small segments have been merged and are still there the largest that is whole counts.
        """
        return retried(self._look)

    def _look(self) -> list[Segment]:
        named = self.all_segments()
        found: list[Segment] = []
        end = 0
        while here := [one for one in map(self._checked, (one for one in named if one.first == end)) if one]:
            found.append(max(here, key=lambda one: one.end))
            end = found[-1].end
        return found

    def all_segments(self) -> list[Segment]:
        """List all segments by their names, whole or not, in the order of their draws."""
        if not self.folder.is_dir():
            return []
        named = (Segment.named(path) for path in self.folder.iterdir())
        return sorted((one for one in named if one is not None), key=lambda one: (one.first, one.end))

    def caution(self) -> str | None:
        """Say in a line what is damaged, if anything is."""
        whole = self.segments()
        n = whole[-1].end if whole else 0
        bad = next((one for one in self.all_segments() if one.end > n), None)
        if bad is None:
            return None
        what = "is truncated or damaged" if bad.first <= n else f"has no draw {n} before it"
        return f"{bad.path}: {what}: of chain {self.chain} the first {n} draws are kept, which are whole"

    def tidy(self, variables: Sequence[Variable]) -> list[Segment]:
        """Remove what a killed process has left, set aside what is damaged and what comes after it; list what is left.

        Raises
        ------
        OSError
            If the folder cannot be written.
        """
        for path in self.folder.glob(".*.partial-*"):
            path.unlink(missing_ok=True)
        for one in self.segments():
            if one.image is not None:
                write_segment(self.folder, self.chain, one.first, read_segment(one), variables)
        kept = self.segments()
        end = kept[-1].end if kept else 0
        for one in self.all_segments():
            if one.end > end:
                aside = self.folder / ASIDE
                aside.mkdir(exist_ok=True)
                one.path.replace(aside / one.path.name)
            elif one not in kept:
                one.path.unlink(missing_ok=True)
        return kept

    def _checked(self, segment: Segment) -> Segment | None:
        """Check a file once, unless it changes; return it, or what remains of it."""
        about = segment.path.stat()
        key = segment.path, about.st_size, about.st_mtime_ns, about.st_ino
        if key not in self._seen:
            self._seen[key] = segment if is_whole(segment.path) else remains_of(segment)
        return self._seen[key]


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
