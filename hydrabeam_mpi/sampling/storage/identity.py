"""Whether chains are of a job: what differs, in words."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hydrabeam_mpi.errors import InputError

LONGEST = 60
"""Characters of a value that are shown: more would hide the rest of the line."""


def check_same(chains: Mapping[str, Any], job: Mapping[str, Any], path: Path) -> None:
    """Make sure that chains are of a job.

    Parameters
    ----------
    chains, job : mapping
        What they are known by: tables of tables of values.
    path : Path
        Where that of the chains stands.

    Raises
    ------
    InputError
        If something differs; names the first, with both values.
    """
    theirs, ours = dict(_leaves(chains)), dict(_leaves(job))
    for key in [*ours, *theirs]:
        if theirs.get(key) != ours.get(key):
            told = f"is {_shown(theirs.get(key))} in the chains, and {_shown(ours.get(key))} in the job"
            remedy = "name another folder, or run the job that the chains are of"
            raise InputError(told, file=path, field=key, remedy=remedy)


def _leaves(table: Mapping[str, Any], names: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, (*names, name))
        else:
            yield " ".join((*names, name)), value


def _shown(value: Any) -> str:
    text = "missing" if value is None else json.dumps(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
