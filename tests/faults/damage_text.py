"""Mutations of text (tables, VOTables, job files as text) and of JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from tests.faults.damage import Damage, Mutator, Rng, pick

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (b"nan", b"inf", b"-inf", b"1e300", b"-1", b"0", b"x", b"", b"1e-300", b"1,5", b"99999999999999999999", b"1j")
PIECES = (b"\x00", b"\xff\xfe", b"\xc3", b"<", "é".encode(), "\u202e".encode(), b"'", b'"', b"\n\n", b"[" * 5000, b"#")


def change_number(path: Path, rng: Rng) -> Damage:
    content = path.read_bytes()
    found = list(NUMBER.finditer(content))
    if not found:
        return insert(path, rng)
    match, number = pick(rng, found), pick(rng, NUMBERS)
    path.write_bytes(content[: match.start()] + number + content[match.end() :])
    return Damage(f"{match[0].decode()} at byte {match.start()} is now {number.decode()}")


def insert(path: Path, rng: Rng) -> Damage:
    content, piece = path.read_bytes(), pick(rng, PIECES)
    place = int(rng.integers(len(content) + 1))
    path.write_bytes(content[:place] + piece + content[place:])
    return Damage(f"{piece[:8]!r} ({len(piece)} bytes) put in at byte {place}")


def drop_or_repeat_line(path: Path, rng: Rng) -> Damage:
    lines = path.read_bytes().splitlines(keepends=True)
    number = int(rng.integers(len(lines)))
    twice = rng.random() < 0.5
    path.write_bytes(b"".join(lines[:number] + [lines[number]] * (2 * twice) + lines[number + 1 :]))
    return Damage(f"line {number + 1} {'twice' if twice else 'removed'}")


def swap_words(path: Path, rng: Rng) -> Damage:
    words = re.split(rb"(\s+)", path.read_bytes())
    one, other = (2 * int(rng.integers(-(-len(words) // 2))) for _ in range(2))
    words[one], words[other] = words[other], words[one]
    path.write_bytes(b"".join(words))
    return Damage(f"words {words[other][:20]!r} and {words[one][:20]!r} swapped")


def encode_otherwise(path: Path, rng: Rng) -> Damage:
    text, code = path.read_text(), pick(rng, ["utf-16", "utf-8-sig", "utf-32", "utf-16-be"])
    path.write_bytes(text.encode(code))
    return Damage(f"encoded as {code}")


def end_lines_otherwise(path: Path, rng: Rng) -> Damage:
    ending = pick(rng, [b"\r\n", b"\r"])
    path.write_bytes(path.read_bytes().replace(b"\n", ending))
    return Damage(f"lines end with {ending!r}")


TEXT: tuple[Mutator, ...] = (
    change_number, change_number, change_number, insert, insert, drop_or_repeat_line, swap_words, encode_otherwise,
    end_lines_otherwise,
)  # fmt: skip

JSON_VALUES = (
    None, True, -1, 0, 1e300, float("nan"), float("inf"), "", "text", "<script>", [], {}, [1], {"a": 1}, [[[]]],
    "\ud800",
)  # fmt: skip


def _places(value: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """List the ways to everything in a JSON value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [found for key, inner in items for found in [(*way, key), *_places(inner, (*way, key))]]


def change_json(path: Path, rng: Rng) -> Damage:
    table = json.loads(path.read_text())
    # First a depth, then a place: else the many numbers of long lists would be drawn nearly always.
    places = _places(table)
    depth = pick(rng, sorted({len(place) for place in places}))
    *way, key = pick(rng, [place for place in places if len(place) == depth])
    holder = table
    for step in way:
        holder = holder[step]
    action = pick(rng, ["delete", "replace", "replace", "replace", "rename"])
    new = pick(rng, JSON_VALUES)
    if action == "delete":
        del holder[key]
    elif action == "rename" and isinstance(holder, dict):
        holder[str(key) + "_"] = holder.pop(key)
    else:
        holder[key] = new
    path.write_text(json.dumps(table))
    return Damage(f"{'/'.join(map(str, [*way, key]))}: {action} {new if action == 'replace' else ''}")


def other_json(path: Path, rng: Rng) -> Damage:
    content = pick(rng, ["null", "[]", "{}", "3", '"x"', "", "{", "[" * 100000, "NaN", '{"channels": [{}]}'])
    path.write_text(content)
    return Damage(f"replaced by {content[:20]}")


JSON: tuple[Mutator, ...] = (change_json, change_json, change_json, change_json, other_json)
