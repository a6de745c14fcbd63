"""What pages show of the code: tables of job keys, of effects and of the loop's record, and the tutorial.

A page has a line such as ``<!-- made: job_keys -->`` where one of the functions of `PARTS` puts its text.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from hydrabeam_mpi.config import Job, Section
from hydrabeam_mpi.config.quantities import Quantity
from hydrabeam_mpi.config.text import toml_value

HERE = Path(__file__).parent
MARK = re.compile(r"^<!-- made: (\w+) -->$", re.MULTILINE)
LIMITS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
PLAIN = {bool: "true or false", int: "whole number", float: "number", str: "text", Path: "file name"}


def fill(app: Any, page: str, source: list[str]) -> None:
    """Replace the marks of a page, as Sphinx reads it."""
    source[0] = MARK.sub(lambda found: PARTS[found[1]](), source[0])


def job_keys() -> str:
    """Return a table of keys for each table of a job."""
    return "\n".join(_sections("", Job))


def _sections(name: str, section: type[Section]) -> Iterator[str]:
    inner = []
    yield f"## `{name}`\n" if name else "## The top of the file\n"
    yield f"{inspect.cleandoc(section.__doc__ or '')}\n"
    rows = []
    for key, field in section.model_fields.items():
        table, is_list = table_of(field.annotation)
        if table is not None:
            path = f"{name.strip('[]')}.{key}".lstrip(".")
            inner.append((f"[[{path}]]" if is_list else f"[{path}]", table))
        else:
            rows.append(_row(key, field))
    if rows:
        yield "| key | type | default | meaning |\n|---|---|---|---|"
        yield "\n".join(rows) + "\n"
    for path, table in inner:
        yield from _sections(path, table)


def table_of(annotation: Any) -> tuple[type[Section] | None, bool]:
    """Return the table that a key is, if it is one, and whether there may be several."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation, False
    for part in get_args(annotation):
        table, _ = table_of(part)
        if table is not None:
            return table, get_origin(annotation) is tuple
    return None, False


def _row(key: str, field: FieldInfo) -> str:
    """Return the line of a key; units stand with the type."""
    unit = unit_of(field.annotation, *field.metadata)
    kind = type_words(field.annotation, unit)
    limits = " and ".join(_limits(field.metadata))
    meaning = str(field.description)
    if unit is not None:
        meaning = re.sub(rf"^{unit},? ?", "", meaning)
    cells = (f"`{key}`", f"{kind} {limits}".strip(), _default(field, unit), meaning)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _default(field: FieldInfo, unit: str | None) -> str:
    if field.default is PydanticUndefined or field.is_required():
        return "has to be given"
    return "none" if field.default in (None, (), {}) else f"`{toml_value(field.default, unit)}`"


def _limits(metadata: Any) -> Iterator[str]:
    for one in metadata:
        for name, sign in LIMITS.items():
            if getattr(one, name, None) is not None:
                yield f"{sign} {getattr(one, name):.4g}"


def unit_of(*parts: Any) -> str | None:
    """Find the unit of a quantity in its type."""
    for part in parts:
        quantity = getattr(part, "func", None)
        if isinstance(quantity, Quantity):
            return quantity.unit
        if unit := unit_of(*get_args(part)):
            return unit
    return None


def type_words(kind: Any, unit: str | None = None) -> str:
    """Say in words what kind of value it is."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return type_words(parts[0], unit)
    if origin in (Union, UnionType):
        return type_words(next(part for part in parts if part is not NoneType), unit)
    if origin is Literal:
        return "one of " + ", ".join(f"`{word}`" for word in parts) if len(parts) < 8 else "one of those below"
    if origin is tuple and parts[-1] is Ellipsis:
        return f"list of {type_words(parts[0], unit)}"
    if origin is tuple:
        return f"[{', '.join(type_words(part, unit) for part in parts)}]"
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


PARTS = {"job_keys": job_keys, "tutorial": tutorial}
