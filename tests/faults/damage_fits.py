"""Mutations of FITS files: header cards and numbers that cannot be."""

from __future__ import annotations

import re
import struct
from pathlib import Path

from tests.faults.damage import Damage, Mutator, Rng, pick

BLOCK, CARD = 2880, 80
VALUES = ("-1", "0", "1", "7", "2147483647", "1E300", "-1.5", "NAN", "'text    '", "''", "T", "", "'unclosed", "(1, 2)")
# To turn a big-endian float into one that is none: quiet NaN, infinity, the largest.
FLOATS = {
    4: (b"\x7f\xc0\x00\x00", b"\x7f\x80\x00\x00", b"\xff\x7f\xff\xff"),
    8: (struct.pack(">d", float("nan")), struct.pack(">d", float("inf")), struct.pack(">d", 1e300)),
}


def _headers(content: bytes) -> list[tuple[int, int]]:
    """Find the headers: (first byte, byte after the last card)."""
    found = []
    for start in range(0, len(content), BLOCK):
        if content[start : start + 8] in (b"SIMPLE  ", b"XTENSION"):
            end = start
            while content[end : end + 8] != b"END     " and end + CARD < len(content):
                end += CARD
            found.append((start, end))
    return found


def _cards(content: bytes) -> list[int]:
    """First bytes of all cards with a value."""
    return [
        place
        for start, end in _headers(content)
        for place in range(start, end, CARD)
        if content[place + 8 : place + 10] == b"= "
    ]


def change_card(path: Path, rng: Rng) -> Damage:
    content = path.read_bytes()
    place, value = pick(rng, _cards(content)), pick(rng, VALUES)
    name = content[place : place + 8].decode("ascii")
    card = f"{name}= {value:>20}".ljust(CARD).encode("ascii")
    path.write_bytes(content[:place] + card + content[place + CARD :])
    return Damage(f"{name.strip()} = {value} (was {content[place + 10 : place + 30].decode('ascii').strip()})")


def blank_card(path: Path, rng: Rng) -> Damage:
    content = path.read_bytes()
    place = pick(rng, _cards(content))
    name = content[place : place + 8].decode("ascii").strip()
    path.write_bytes(content[:place] + b" " * CARD + content[place + CARD :])
    return Damage(f"{name} removed")


def copy_card(path: Path, rng: Rng) -> Damage:
    content = path.read_bytes()
    one, other = pick(rng, _cards(content)), pick(rng, _cards(content))
    names = [content[place : place + 8].decode("ascii").strip() for place in (one, other)]
    path.write_bytes(content[:other] + content[one : one + CARD] + content[other + CARD :])
    return Damage(f"{names[1]} overwritten by a second {names[0]}")


def strange_number(path: Path, rng: Rng) -> Damage:
    """Put what is no number among the data, where the file has floats."""
    content = bytearray(path.read_bytes())
    headers = _headers(content)
    which = int(rng.integers(len(headers)))
    start, end = headers[which]
    stop = headers[which + 1][0] if which + 1 < len(headers) else len(content)
    said = re.search(rb"BITPIX  = +(-?\d+)", content[start:end])
    size = 4 if said and said[1] == b"-32" else 8
    first = -(-(end + CARD) // BLOCK) * BLOCK
    if stop - first < size:
        return change_card(path, rng)
    place = first + size * int(rng.integers((stop - first) // size))
    value = pick(rng, FLOATS[size])
    content[place : place + size] = value
    path.write_bytes(content)
    return Damage(f"{value.hex()} at byte {place}, {place - first} of the data of HDU {which}")


FITS: tuple[Mutator, ...] = (change_card, change_card, blank_card, copy_card, strange_number)
