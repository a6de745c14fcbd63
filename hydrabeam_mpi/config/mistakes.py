"""What is wrong with a job file, in one line that names the key, what it should be, and what it is."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from hydrabeam_mpi.errors import InputError

Model = type[BaseModel]
Details = dict[str, Any]

# The library's words are about its own types; these are about TOML. Its error types begin with these keys.
SHOULD_BE: dict[str, Callable[[Details], str]] = {
    "bool_": lambda _: "true or false",
    "int_": lambda _: "a whole number",
    "float_": lambda _: "a number",
    "finite_number": lambda _: "finite",
    "string_": lambda _: "text in quotes",
    "tuple_": lambda _: "a list in brackets",
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
LONGEST_VALUE = 60


def as_input_error(error: ValidationError, model: Model, path: Path) -> InputError:
    """Tell of the first mistake in a job file; a misspelt key comes before what is missing because of it.

    Parameters
    ----------
    error : pydantic.ValidationError
        Of ``model``.
    model : type
        The whole job.
    path : Path
        The job file.
    """
    first = min(error.errors(), key=lambda details: details["type"] != "extra_forbidden")
    sections, names, inside = _locate(first["loc"], model)
    field = " ".join([f"[{'.'.join(sections)}]"] * bool(sections) + names)
    if first["type"] == "extra_forbidden":
        if isinstance(first["input"], dict):
            field = f"[{'.'.join(sections + names)}]"
        remedy = _suggestion(sections, inside, names[0], model)
        return InputError("unknown key", file=path, field=field, remedy=remedy)
    if first["type"] == "missing" and isinstance(first["loc"][-1], str):
        remedy = "add it; 'hydrabeam init' prints a whole job"
        return InputError("is missing", file=path, field=field, remedy=remedy)
    if first["type"] == "value_error" and not names:
        # Keys that do not fit together; the sections' own words name them.
        message, _, remedy = _should_be(first).partition("; ")
        return InputError(message, file=path, field=field, remedy=remedy)
    remedy = f"it should be {_should_be(first)}"
    return InputError(f"is {_shown(first)}", file=path, field=field, remedy=remedy)


def _locate(location: tuple[int | str, ...], model: Model) -> tuple[list[str], list[str], Model]:
    """Divide a place in the job into tables and key, and return the model of the innermost table."""
    sections: list[str] = []
    names = [part for part in location if isinstance(part, str)]
    while names and (inner := _table_of(model, names[0])):
        sections.append(names.pop(0))
        model = inner
    return sections, names, model


def _table_of(model: Model, name: str) -> Model | None:
    """Return the model of a table within ``model``, or None if ``name`` is a plain key or unknown."""
    if name not in model.model_fields:
        return None
    annotation = model.model_fields[name].annotation
    candidates = [annotation, *getattr(annotation, "__args__", ())]
    return next((item for item in candidates if isinstance(item, type) and issubclass(item, BaseModel)), None)


def _suggestion(sections: list[str], inside: Model, key: str, job: Model) -> str:
    """Name the nearest key of the same table, or else the table where the key belongs."""
    near = difflib.get_close_matches(key, inside.model_fields, n=1)
    if near:
        return f"did you mean '{near[0]}'?"
    elsewhere = [place for place, name in _all_keys(job) if name == key]
    if elsewhere:
        return f"it belongs in {' or '.join(elsewhere)}"
    within = f"[{'.'.join(sections)}]" if sections else "a job"
    return f"the keys of {within} are {', '.join(inside.model_fields)}"


def _all_keys(model: Model, sections: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    """Yield every key of a job behind the table that it stands in."""
    for name in model.model_fields:
        inner = _table_of(model, name)
        yield (
            f"[{'.'.join((*sections, *[name] * bool(inner)))}]" if sections or inner else "the first lines",
            name,
        )
        if inner:
            yield from _all_keys(inner, (*sections, name))


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
    text = json.dumps(details["input"], default=str)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
