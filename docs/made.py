"""What pages show of the code: tables of job keys, of effects and of the loop's record, and the tutorial.

A page has a line such as ``<!-- made: job_keys -->`` where one of the functions of `PARTS` puts its text.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from hydrabeam_mpi.commands.effects import words_of
from hydrabeam_mpi.config import Job, Section
from hydrabeam_mpi.config.text import tables_of, toml_value, unit_of
from hydrabeam_mpi.effects.registry import KINDS
from hydrabeam_mpi.io import posterior_file, truth_file

HERE = Path(__file__).parent
MARK = re.compile(r"^<!-- made: (\w+) -->$", re.MULTILINE)
PIPE = r"\|"
"""A bar within a cell of a table."""
LIMITS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
PLAIN = {bool: "true or false", int: "whole number", float: "number", str: "text", Path: "file name"}


def fill(app: Any, page: str, source: list[str]) -> None:
    """Replace the marks of a page, as Sphinx reads it."""
    source[0] = MARK.sub(lambda found: PARTS[found[1]](), source[0])


def job_keys() -> str:
    """Return a table of keys for each table of a job."""
    return "\n".join(_sections("", Job))


def _sections(name: str, section: type[Section]) -> Iterator[str]:
    inner = tables_of(section)
    yield f"## `{name}`\n" if name else "## The top of the file\n"
    yield f"{inspect.cleandoc(section.__doc__ or '')}\n"
    rows = [_row(key, field) for key, field in section.model_fields.items() if key not in inner]
    if rows:
        yield "| key | type | default | meaning |\n|---|---|---|---|"
        yield "\n".join(rows) + "\n"
    for key, (table, is_list) in inner.items():
        path = f"{name.strip('[]')}.{key}".lstrip(".")
        yield from _sections(f"[[{path}]]" if is_list else f"[{path}]", table)


def _row(key: str, field: FieldInfo) -> str:
    """Return the line of a key; units stand with the type."""
    unit = unit_of(field.annotation, *field.metadata)
    kind = type_words(field.annotation, unit)
    limits = " and ".join(_limits(field.metadata))
    meaning = str(field.description)
    if unit is not None:
        meaning = re.sub(rf"^{unit},? ?", "", meaning)
    cells = (f"`{key}`", f"{kind} {limits}".strip(), _default(field, unit), meaning)
    return f"| {' | '.join(cell.replace('|', PIPE) for cell in cells)} |"


def _default(field: FieldInfo, unit: str | None) -> str:
    if field.default is PydanticUndefined or field.is_required():
        return "has to be given"
    return "none" if field.default in (None, (), {}) else f"`{toml_value(field.default, unit)}`"


def _limits(metadata: Any) -> Iterator[str]:
    for one in metadata:
        for name, sign in LIMITS.items():
            if getattr(one, name, None) is not None:
                yield f"{sign} {getattr(one, name):.4g}"


def type_words(kind: Any, unit: str | None = None) -> str:
    """Say in words what kind of value it is."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return type_words(parts[0], unit)
    if origin in (Union, UnionType):
        return type_words(next(part for part in parts if part is not NoneType), unit)
    if origin is Literal:
        return ", ".join(f"`{word}`" for word in parts) if len(parts) <= 8 else "name of an effect"
    if origin is tuple and parts[-1] is Ellipsis:
        of = type_words(parts[0]).replace("name of an effect", "effects' names")
        words = f"list of {of}{'s' * of.endswith(('number', 'name', 'text', 'effect'))}"
        return f"{words}, {unit}" if unit else words
    if origin is tuple:
        words = f"[{', '.join(type_words(part) for part in parts)}]"
        return f"{words}, {unit}" if unit else words
    if origin is dict:
        return "table"
    return f"{PLAIN[kind]}, {unit}" if unit and kind is float else PLAIN[kind]


def tutorial() -> str:
    """Return the cells of the tutorial's script as a page."""
    cells = re.split(r"^# %%", (HERE / "tutorial.py").read_text(), flags=re.MULTILINE)
    text = []
    for cell in filter(None, cells):
        kind, _, body = cell.partition("\n")
        if "markdown" in kind:
            text.append(re.sub(r"^# ?", "", body, flags=re.MULTILINE).strip())
        else:
            text.append(f"```python\n{body.strip()}\n```")
    return "\n\n".join(text)


def posterior_layout() -> str:
    """Return the layout of posterior.h5, of which the tables of the module's docstring are text."""
    text = inspect.cleandoc(str(posterior_file.__doc__)).partition("Layout\n------\n")[2]
    return "```{eval-rst}\n" + re.sub(r"(?<!`)`([^`]+)`(?!`)", r"``\1``", text) + "\n```"


def truth_layout() -> str:
    """Return the data sets of truth.h5."""
    rows = [f"| `{name}` | {unit} | {what} |" for name, (unit, what) in truth_file.DATA_SETS.items()]
    return "\n".join(["| data set | unit | |", "|---|---|---|", *rows])


def loop_schema() -> str:
    """Return tables of the keys of loop.json, from its schema."""
    schema = json.loads((files("hydrabeam_mpi.tables") / "loop.schema.json").read_text())
    text = ["## The top level\n", *_schema_rows(schema)]
    for name, one in schema["$defs"].items():
        text += [f"\n## {name.replace('_', ' ').capitalize()}\n", f"{one['description']}\n", *_schema_rows(one)]
    return "\n".join(text)


def _schema_rows(schema: dict[str, Any]) -> Iterator[str]:
    yield "| key | type | meaning |\n|---|---|---|"
    for key, one in schema["properties"].items():
        inner = one.get("items", one).get("properties", {})
        meaning = one.get("description", "")
        if inner:
            told = "; ".join(f"`{name}`: {about.get('description', '')}".rstrip(": ") for name, about in inner.items())
            meaning += f" ({told})"
        yield f"| `{key}` | {_schema_type(one)} | {meaning.replace('|', PIPE)} |"


def _schema_type(one: dict[str, Any]) -> str:
    """Say in words of which type a value is."""
    if "anyOf" in one:
        return " or ".join(_schema_type(part) for part in one["anyOf"])
    if "$ref" in one:
        name = one["$ref"].rpartition("/")[2]
        return f"[{name.replace('_', ' ')}](#{name.replace('_', '-')})"
    if "enum" in one:
        return ", ".join(f"`{word}`" for word in one["enum"])
    if "const" in one:
        return f"`{one['const']}`"
    told = one["type"] if isinstance(one["type"], list) else [one["type"]]
    words = " or ".join({"object": "table", "string": "text"}.get(kind, kind) for kind in told)
    return f"list of {_schema_type(one['items'])}" if told == ["array"] else words


def effects() -> str:
    """Return what the effects' own words say of them: equations, signs, units and settings."""
    return "\n".join(map(words_of, KINDS))


PARTS = {part.__name__: part for part in (effects, job_keys, loop_schema, posterior_layout, truth_layout, tutorial)}
