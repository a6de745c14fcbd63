"""A job file as text: every key with its value or its default, its unit and its meaning."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BeforeValidator
from pydantic.fields import FieldInfo

from hydrabeam_mpi.config.base import Section
from hydrabeam_mpi.config.quantities import Quantity
from hydrabeam_mpi.errors import printable

COMMENT_COLUMN = 44
MAX_LINE = 120


def tables_of(section: type[Section]) -> dict[str, tuple[type[Section], bool]]:
    """Return the tables within a table by their names, and whether there may be several of each."""
    found = {name: _table_of(field.annotation) for name, field in section.model_fields.items()}
    return {name: one for name, one in found.items() if one is not None}


def _table_of(annotation: Any) -> tuple[type[Section], bool] | None:
    """Return the table that a key is, if it is one, and whether there may be several."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation, False
    for part in get_args(annotation):
        if (found := _table_of(part)) is not None:
            return found[0], get_origin(annotation) is tuple
    return None


def table_text(
    name: str, section: type[Section], values: Mapping[str, Any], remarks: Sequence[str] = (), *, given: bool = True
) -> list[str]:
    """Return the lines of a table: what it is about, remarks, and its keys as of `keys_text`.

    Parameters
    ----------
    name : str
    section : type
    values : mapping
    remarks : sequence of str
    given : bool
        False for a table that stands in comments as a whole.
    """
    about = inspect.cleandoc(section.__doc__ or "")
    header = f"[{name}]" if given else f"# [{name}]"
    # Remarks tell names from data files, which would otherwise end the comment with a line feed of their own.
    return ["", header, *(f"# {printable(remark)}" for remark in (about, *remarks)), *keys_text(section, values)]


def keys_text(section: type[Section], values: Mapping[str, Any]) -> list[str]:
    """Return a line for each key of a table: its value, or in a comment its default; then what it means."""
    lines = []
    for name, field in section.model_fields.items():
        if field.description is None:  # a table
            continue
        unit = unit_of(field.annotation, *field.metadata)
        if name in values:
            line = f"{name} = {toml_value(values[name], unit)}"
        elif field.is_required() or field.default in (None, ()):
            line = f"# {name} = {_placeholder(field, unit)}"
        else:
            line = f"# {name} = {toml_value(field.default, unit)}"
        needed = "has to be given: " if field.is_required() else ""
        comment = f"# {needed}{_choices(field)}{field.description}"
        beside = f"{line:<{COMMENT_COLUMN}} {comment}"
        lines += [beside] if len(beside) <= MAX_LINE else [comment, line]
    return lines


def toml_value(value: Any, unit: str | None = None) -> str:
    """Write a value, with its unit where it has one."""
    if isinstance(value, tuple):
        items = [toml_value(item, unit) for item in value]
        if sum(map(len, items)) <= MAX_LINE:
            return f"[{', '.join(items)}]"
        return "\n".join(["[", *(f"    {item}," for item in items), "]"])
    if unit == "Hz":
        return f'"{frequency_text(value)}"'
    if unit is not None:
        return f'"{value:.15g} {unit}"'
    # Text in JSON is text in TOML, but for one control character that only TOML wants escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def frequency_text(freq: float) -> str:
    """Write a frequency in Hz with a unit that suits it."""
    return f"{freq / 1e6:.12g} MHz" if freq >= 1e6 else f"{freq / 1e3:.12g} kHz"


def unit_of(*parts: Any) -> str | None:
    """Find the unit of a key in its type."""
    for part in parts:
        if isinstance(part, BeforeValidator) and isinstance(part.func, Quantity):
            return part.func.unit
        if unit := unit_of(*get_args(part)):
            return unit
    return None


def _kind(field: FieldInfo) -> Any:
    """Return the plain type of a key, whether or not it may be left out."""
    kinds = [kind for kind in get_args(field.annotation) if kind is not NoneType]
    kind = kinds[0] if NoneType in get_args(field.annotation) else field.annotation
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def _placeholder(field: FieldInfo, unit: str | None) -> str:
    """Hint at what to write for a key without a default."""
    kind = _kind(field)
    if unit:
        item = '"... MHz"' if unit == "Hz" else f'"... {unit}"'
    else:
        item = '"..."' if kind in (str, Path) or get_origin(kind) is Literal else "..."
    return f"[{item}]" if "tuple[" in str(kind) else item


def _choices(field: FieldInfo) -> str:
    """List the words to choose from, where a key is one of several."""
    words = get_args(_kind(field)) if get_origin(_kind(field)) is Literal else ()
    return f"{', '.join(words)}: " if words else ""
