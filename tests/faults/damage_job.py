"""Mutations of job files: keys and values that TOML allows and a job does not."""

from __future__ import annotations

import copy
import math
import re
import tomllib
from pathlib import Path
from typing import Any

import tomli_w

from tests.faults.damage import Damage, Mutator, Rng, pick

HUGE = (10**10, 10**12, 10**15, 2**63, 10**30, 1e300)
# A text such as '14 m' stands where a number may.
QUANTITY = re.compile(r"-?\d")
# Keys of which a negative number has a meaning, or a text any value.
SIGNED = re.compile(r"latitude|longitude|height|spectral_index|parameters|values|strength")


def _leaves(value: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """List the ways to all values that are neither table nor array, and to arrays themselves."""
    if isinstance(value, dict):
        return [found for key, inner in value.items() for found in _leaves(inner, (*way, key))]
    if isinstance(value, list):
        return ([way] if way else []) + [
            found for number, inner in enumerate(value) for found in _leaves(inner, (*way, number))
        ]
    return [way]


def _get(table: Any, way: tuple[Any, ...]) -> Any:
    for step in way:
        table = table[step]
    return table


def _edit(path: Path, rng: Rng, change: Any) -> Damage:
    """Change the value at a leaf by ``change(rng, value, name)``, which returns the new value and whether illegal."""
    table = tomllib.loads(path.read_text())
    way = pick(rng, _leaves(table))
    name = ".".join(map(str, way))
    old = _get(table, way)
    new, illegal = change(rng, copy.deepcopy(old), name)
    _get(table, way[:-1])[way[-1]] = new
    path.write_text(tomli_w.dumps(table))
    return Damage(f"{name} = {str(new)[:40]!r} (was {str(old)[:40]!r})", illegal)


def _of_another_type(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    others = {"text": "text", "number": 3, "flag": True, "list": [1, "x"], "table": {"a": 1}, "lists": [[[]]]}
    own = {str: "text", int: "number", float: "number", bool: "flag", list: "list"}[type(value)]
    kind = pick(rng, sorted(others.keys() - {own}))
    # A quantity may be a number.
    return others[kind], not (own == "text" and kind == "number" and _is_number(value))


def _no_number(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    number = pick(rng, [math.nan, math.inf, -math.inf])
    return ([number] if isinstance(value, list) else number), True


def _is_number(value: Any) -> bool:
    """Whether a number may stand in place of a value, as far as its type goes."""
    return not isinstance(value, bool) and bool(QUANTITY.match(str(value)))


def _huge(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    number = pick(rng, HUGE)
    return ([number] if isinstance(value, list) else number), not isinstance(value, list) and not _is_number(value)


def _tiny(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    return pick(rng, [1e-300, 5e-324, 1e-200, 1e-30]), not _is_number(value)


def _negative(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    number = pick(rng, [-1, -0.5, -1e10])
    return number, not SIGNED.search(name)


def _zero(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    return 0, not _is_number(value)


def _empty(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    return ([] if isinstance(value, list) else ""), False


def _odd_text(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    text = pick(rng, ["é", "\u202e", "a\nb", "\x00", "x" * 5000, "../../..", "~", "*", "[", "10 kg", "1 / 0", "<b>"])
    free = isinstance(value, str) and name == "name"
    return ([text] if isinstance(value, list) else text), not free


def _longer(rng: Rng, value: Any, name: str) -> tuple[Any, bool]:
    return (value * 2 if isinstance(value, list | str) else [value, value]), not isinstance(value, list | str)


def _table_edit(path: Path, rng: Rng) -> tuple[dict[str, Any], list[tuple[Any, ...]]]:
    table = tomllib.loads(path.read_text())
    return table, _tables(table)


def _tables(value: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """List the ways to all tables."""
    if isinstance(value, dict):
        return [way, *(found for key, inner in value.items() for found in _tables(inner, (*way, key)))]
    if isinstance(value, list):
        return [found for number, inner in enumerate(value) for found in _tables(inner, (*way, number))]
    return []


def unknown_key(path: Path, rng: Rng) -> Damage:
    table, tables = _table_edit(path, rng)
    way = pick(rng, tables)
    key = pick(rng, ["unknown", "nmodes", "", "é", "a.b", "Files", "__class__"])
    _get(table, way)[key] = 1
    path.write_text(tomli_w.dumps(table))
    free = way and way[-1] in ("parameters", "settings")
    return Damage(f"unknown key {key!r} in {'.'.join(map(str, way)) or 'the whole'}", illegal=not free)


def delete_key(path: Path, rng: Rng) -> Damage:
    table, tables = _table_edit(path, rng)
    way = pick(rng, [way for way in tables if _get(table, way)])
    holder = _get(table, way)
    key = pick(rng, sorted(holder))
    del holder[key]
    path.write_text(tomli_w.dumps(table))
    return Damage(f"{'.'.join(map(str, (*way, key)))} deleted")


def move_table(path: Path, rng: Rng) -> Damage:
    """Put one table into another, or in the place of a key."""
    table, tables = _table_edit(path, rng)
    one, other = pick(rng, tables), pick(rng, tables)
    inner = copy.deepcopy(_get(table, one))
    _get(table, other)[pick(rng, ["data", "sky", "effects", "basis", "simulate"])] = inner
    path.write_text(tomli_w.dumps(table))
    return Damage(f"{'.'.join(map(str, one)) or 'the whole'} put into {'.'.join(map(str, other)) or 'the whole'}")


def duplicate_key(path: Path, rng: Rng) -> Damage:
    lines = path.read_text().splitlines()
    number = pick(rng, [i for i, line in enumerate(lines) if re.match(r"\w+ = [^\[]", line) or re.match(r"\[\w", line)])
    lines.insert(number + 1, lines[number])
    path.write_text("\n".join(lines) + "\n")
    return Damage(f"line {number + 1} ({lines[number][:30]}) twice", illegal=True)


def deep(path: Path, rng: Rng) -> Damage:
    depth = pick(rng, [50, 500, 5000])
    text = pick(
        rng, ["a = " + "[" * depth + "]" * depth, "a." * depth + "b = 1", "a = " + "{a=" * depth + "1" + "}" * depth]
    )
    path.write_text(text + "\n" + path.read_text())
    return Damage(f"nested {depth} deep: {text[:12]}", illegal=True)


def _leaf(change: Any) -> Mutator:
    def mutate(path: Path, rng: Rng) -> Damage:
        return _edit(path, rng, change)

    return mutate


TOML: tuple[Mutator, ...] = (
    *map(_leaf, (_of_another_type, _of_another_type, _no_number, _no_number, _huge, _huge, _tiny, _negative)),
    *map(_leaf, (_negative, _zero, _empty, _odd_text, _longer)),
    unknown_key, delete_key, delete_key, move_table, duplicate_key, deep,
)  # fmt: skip
