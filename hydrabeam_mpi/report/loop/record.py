"""``loop.json`` as the report needs it: read once, and asked for numbers that may be missing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS, SEPARATE
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.formats import read_loop
from hydrabeam_mpi.report.page.key_numbers import Kind, format_value
from hydrabeam_mpi.words import effect_words

Entry = dict[str, Any]
VERDICTS = ("consistent", "explained", "unexplained", "convention", "interrupted")
REMEDY = "run 'hydrabeam loop' again"


def load_loop(directory: Path) -> Entry | None:
    """Read ``loop.json`` of a result folder; None where there is none.

    Raises
    ------
    InputError
        If it cannot be read, or has no verdict.
    """
    path = directory / "loop.json"
    if not path.exists():
        return None
    loop = read_loop(path, REMEDY)
    if loop.get("verdict") not in VERDICTS:
        raise InputError(f"is none of {', '.join(VERDICTS)}", file=path, field="verdict", remedy=REMEDY)
    return loop


@contextmanager
def as_written(directory: Path, name: str = "loop.json") -> Iterator[None]:
    """Turn failures caused by wrong values in a file of a result into an error about that file.

    Keys that are missing or null are left out; values may be of any wrong type.

    Raises
    ------
    InputError
        If the block raises anything else.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = f"is not as 'hydrabeam loop' writes it ({type(error).__name__}: {error})"
        raise InputError(reason, file=directory / name, remedy=REMEDY) from error


def entries(record: Entry | None, key: str) -> list[Entry]:
    """Return the records listed under a key; none where the key is missing or null."""
    return [entry for entry in ((record or {}).get(key) or []) if isinstance(entry, dict)]


def number(record: Entry | None, key: str) -> float:
    """Return the number under a key; NaN where there is none."""
    value = (record or {}).get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def written(value: float, kind: Kind = "number") -> str:
    """Write a number with three digits or in percent, and a dash where there is none."""
    return format_value(value, kind) if math.isfinite(value) else "–"


def sigmas(value: float) -> str:
    """Write a significance in standard deviations: one decimal, and none where there are many."""
    return f"{value:,.1f}" if abs(value) < 100 else written(value)


def candidate_name(entry: Entry) -> str:
    """Name what was weighed or tried: the words of its kind, with the law by which it changes in time."""
    law = entry.get("law")
    return effect_words(str(entry.get("effect") or "an effect without a name"), None if law is None else str(law))


def candidate_title(entry: Entry) -> str:
    """Name what was weighed as sentences do: "gains that follow the sky's total power"."""
    kind, law = str(entry.get("effect")), entry.get("law")
    for kinds in (EFFECTS, SEPARATE, REWEIGHTINGS):
        if kind in kinds:
            cause = kinds[kind]
            return str(getattr(cause, "laws", {}).get(law, cause.title))
    return candidate_name(entry)


def runner_up(entry: Entry) -> str | None:
    """Name the candidate that came second in a round; None where there was no other."""
    kind = entry.get("runner_up")
    return None if kind is None else candidate_name({"effect": kind, "law": entry.get("runner_up_law")})


def title_of(entry: Entry) -> str:
    """Return the name of a record's effect, as it is used within sentences."""
    return str(entry.get("title") or effect_words(str(entry.get("effect", "an effect without a name"))))


def first_statistics(loop: Entry) -> Entry | None:
    """Return the statistics of the residual before the first round; None where there was no round."""
    rounds = entries(loop, "rounds")
    return rounds[0].get("residual") if rounds else None


def axis_entries(statistics: Entry | None, name: str) -> list[Entry]:
    """Return the entries of an axis of the statistics of a residual."""
    return entries((statistics or {}).get("axes"), name)


def is_complete(statistics: Entry | None, name: str) -> bool:
    """Tell whether all entries of an axis are listed, not only its most significant ones."""
    total = number((statistics or {}).get("entries"), name)
    return not total > len(axis_entries(statistics, name))
