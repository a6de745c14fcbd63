"""What the system tells of memory: how much there is, is free, and has been needed."""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

CGROUPS = Path("/sys/fs/cgroup")


def own_peak_bytes() -> int:
    """Return the largest resident memory that this process has had."""
    # getrusage also counts the program that started this process, before it became this one.
    peak = _bytes_listed("/proc/self/status").get("VmHWM")
    if peak is not None:
        return peak
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def own_bytes() -> int:
    """Return the resident memory that this process has now; its largest where the system does not tell."""
    return _bytes_listed("/proc/self/status").get("VmRSS") or own_peak_bytes()


def free_bytes() -> int | None:
    """Return what this process has allocated and may still get; None where the system does not tell.

    Of what a batch system or a container lets it have counts what it has filled itself.
    """
    known = _bytes_listed("/proc/meminfo") | _bytes_listed("/proc/self/status")
    if not known.keys() >= {"MemAvailable", "SwapFree", "VmData", "VmRSS"}:
        return None
    left = [known["MemAvailable"] + known["SwapFree"], *(limit - known["VmRSS"] for limit in _group_limits())]
    return known["VmData"] + max(min(left), 0)


def machine_bytes() -> int:
    """Return what the machine has, or what a batch system or a container lets its processes have of it."""
    return min([os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), *_group_limits()])


def _group_limits() -> Iterator[int]:
    """Yield the limits of all groups of processes that this one is in."""
    groups = Path("/proc/self/cgroup")
    for line in groups.read_text().splitlines() if groups.exists() else ():
        _, controllers, path = line.split(":", 2)
        if controllers not in ("", "memory"):
            continue
        name = "memory.limit_in_bytes" if controllers else "memory.max"
        root = CGROUPS / controllers
        for folder in (root / path.strip("/"), *(root / path.strip("/")).parents):
            limit = folder / name
            if limit.is_file() and (text := limit.read_text().strip()) != "max":
                yield int(text)


def _bytes_listed(path: str) -> dict[str, int]:
    """Return the sizes that a file of the system lists, by name; nothing on systems that have no such file."""
    try:
        lines = [line.split() for line in Path(path).read_text().splitlines()]
    except OSError:
        return {}
    return {words[0].rstrip(":"): 1024 * int(words[1]) for words in lines if words[2:] == ["kB"]}
