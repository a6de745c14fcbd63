"""What is wrong with a job file, in one line that names the key, what it should be, and what it is."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hydrabeam_mpi.config.base import Section, shown
from hydrabeam_mpi.config.text import tables_of
from hydrabeam_mpi.errors import InputError

Model = type[Section]
Details = dict[str, Any]

# Replace pydantic's messages about its own types by ones about TOML; keys are the beginnings of its error types.
SHOULD_BE: dict[str, Callable[[Details], str]] = {
    "bool_": lambda _: "true or false",
    "int_": lambda _: "a whole number",
    "float_": lambda _: "a number",
    "finite_number": lambda _: "finite",
    "string_": lambda _: "text in quotes",
    "tuple_": lambda _: "a list in brackets",
    "dict_": lambda _: "keys and values in braces",
    "model_": lambda _: "keys and values below a line with its name in brackets",
    "literal_error": lambda context: str(context["expected"]),
    "greater_than_equal": lambda context: f"at least {context['ge']:.10g}",
    "greater_than": lambda context: f"more than {context['gt']:.10g}",
    "less_than_equal": lambda context: f"at most {context['le']:.10g}",
    "too_long": lambda context: f"a list of {context['max_length']}",
    "too_short": lambda context: f"a list of {context['min_length']} or more",
    "missing": lambda _: "a list of two",
    "value_error": lambda context: str(context["error"]),
}


@dataclass(frozen=True)
class _Place:
    """A place in a job: tables within tables, and what within the innermost.

    Attributes
    ----------
    sections : list of str
        Names of the tables.
    inside : type
        Model of the innermost table; the whole job where there is none.
    names : list of str
        Key and what follows it; empty for a table as a whole.
    repeated : bool
        Whether there may be several of the innermost table, below [[...]].
    number : str
        Which of them, from 1, in words.
    """

    sections: list[str]
    inside: Model
    names: list[str]
    repeated: bool
    number: str

    @property
    def table(self) -> str:
        """The innermost table as the line above it names it."""
        return _in_brackets(self.sections, self.repeated) if self.sections else ""

    @property
    def field(self) -> str:
        """All of it in words."""
        return " ".join([part for part in (self.table, self.number) if part] + self.names)


def as_input_error(error: ValidationError, model: Model, path: Path | None = None) -> InputError:
    """Tell of the first mistake in a job file; a misspelt key comes before what is missing because of it.

    Parameters
    ----------
    error : pydantic.ValidationError
        Of ``model``.
    model : type
        The whole job.
    path : Path, optional
        The job file.
    """
    first = min(error.errors(), key=lambda details: details["type"] != "extra_forbidden")
    place = _locate(first["loc"], model)
    field = place.field
    if first["type"] == "extra_forbidden":
        if isinstance(first["input"], dict):
            field = f"[{'.'.join(place.sections + place.names)}]"
        return InputError("unknown key", file=path, field=field, remedy=_suggestion(place, model))
    if first["type"] == "missing" and isinstance(first["loc"][-1], str):
        remedy = "add it" if place.repeated else "add it; 'hydrabeam init' prints a whole job"
        return InputError("is missing", file=path, field=field, remedy=remedy)
    if first["type"] == "value_error" and not place.names:
        # Keys that do not fit together; the sections' own words name them.
        message, _, remedy = _should_be(first).partition("; ")
        return InputError(message, file=path, field=field, remedy=remedy)
    if first["type"] == "tuple_type" and not place.names:
        remedy = f"write {place.table} above each"
        return InputError("there may be several of these", file=path, field=field, remedy=remedy)
    remedy = f"it should be {_should_be(first)}"
    return InputError(f"is {_shown(first)}", file=path, field=field, remedy=remedy)


def _locate(location: tuple[int | str, ...], model: Model) -> _Place:
    """Divide a place in the job into tables and key."""
    parts, sections, repeated, number = list(location), [], False, ""
    while parts and isinstance(name := parts[0], str) and (inner := tables_of(model).get(name)):
        (model, repeated), number = inner, ""
        sections.append(name)
        del parts[0]
        if repeated and parts:
            number = f"number {int(parts.pop(0)) + 1}"
    return _Place(sections, model, [part for part in parts if isinstance(part, str)], repeated, number)


def _in_brackets(sections: Sequence[str], repeated: bool) -> str:
    path = ".".join(sections)
    return f"[[{path}]]" if repeated else f"[{path}]"


def _suggestion(place: _Place, job: Model) -> str:
    """Name the nearest key of the same table, or else the table where the key belongs."""
    key, keys = place.names[0], place.inside.model_fields
    near = difflib.get_close_matches(key, keys, n=1)
    if near:
        return f"did you mean '{near[0]}'?"
    elsewhere = [table for table, name in _all_keys(job) if name == key]
    if elsewhere:
        return f"it belongs in {' or '.join(elsewhere)}"
    return f"the keys of {place.table or 'a job'} are {', '.join(keys)}"


def _all_keys(
    model: Model, table: str = "the first lines", sections: tuple[str, ...] = ()
) -> Iterator[tuple[str, str]]:
    """Yield every key of a job behind the table that it stands in; a table as a key of its own."""
    tables = tables_of(model)
    for name in model.model_fields:
        if name not in tables:
            yield table, name
            continue
        inner, is_repeated = tables[name]
        within = (*sections, name)
        yield (own := _in_brackets(within, is_repeated)), name
        yield from _all_keys(inner, own, within)


def _should_be(details: Any) -> str:
    """Say what a value should be, and where it should be one of several words, which of them is nearest."""
    kind, context, value = details["type"], details.get("ctx", {}), details["input"]
    words = next((words for start, words in SHOULD_BE.items() if kind.startswith(start)), None)
    expected = words(context) if words else str(details["msg"])
    if kind == "literal_error" and isinstance(value, str):
        near = difflib.get_close_matches(value, re.findall("'(.*?)'", expected), n=1)
        expected += f"; did you mean '{near[0]}'?" if near else ""
    return expected


def _shown(details: Any) -> str:
    """Write a value as TOML does, shortened."""
    if details["type"].startswith("model_"):
        return "not a table"
    return shown(details["input"])
