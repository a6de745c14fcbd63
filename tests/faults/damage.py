"""What a mutation did, and mutations of any file: bytes lost, turned or overwritten."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Rng = np.random.Generator


@dataclass(frozen=True)
class Damage:
    """What was done to a file.

    Attributes
    ----------
    words : str
        For the log.
    illegal : bool
        Whether no reader may take the content as it is: a run that does so without a word, and whose result differs
        from the undamaged file's, is wrong in silence. Where False the content may be legal or not.
    """

    words: str
    illegal: bool = False


Mutator = Callable[[Path, Rng], Damage]


def pick(rng: Rng, items: Any) -> Any:
    """Draw one."""
    items = list(items)
    return items[int(rng.integers(len(items)))]


def truncate(path: Path, rng: Rng) -> Damage:
    content = path.read_bytes()
    kept = int(rng.integers(len(content))) if rng.random() < 0.9 else 0
    path.write_bytes(content[:kept])
    return Damage(f"truncated to {kept} of {len(content)} bytes")


def flip_bits(path: Path, rng: Rng) -> Damage:
    content = bytearray(path.read_bytes())
    places = rng.integers(len(content), size=int(rng.choice([1, 3, 30]))) if content else []
    for place in places:
        content[place] ^= 1 << int(rng.integers(8))
    path.write_bytes(content)
    return Damage(f"{len(places)} bits flipped, the first in byte {places[0] if len(places) else None}")


def overwrite_block(path: Path, rng: Rng) -> Damage:
    content = bytearray(path.read_bytes())
    size = min(int(rng.choice([8, 64, 512, 4096])), len(content))
    start = int(rng.integers(len(content) - size + 1))
    zeros = rng.random() < 0.5
    content[start : start + size] = bytes(size) if zeros else rng.bytes(size)
    path.write_bytes(content)
    return Damage(f"{size} bytes from {start} {'zeroed' if zeros else 'random'}")


def remove_block(path: Path, rng: Rng) -> Damage:
    content = path.read_bytes()
    size = min(int(rng.choice([1, 8, 512, 2880])), len(content))
    start = int(rng.integers(len(content) - size + 1))
    path.write_bytes(content[:start] + content[start + size :])
    return Damage(f"{size} bytes from {start} cut out")


def append(path: Path, rng: Rng) -> Damage:
    size = int(rng.choice([1, 100, 5000]))
    with path.open("ab") as file:
        file.write(rng.bytes(size))
    return Damage(f"{size} random bytes appended")


def replace_whole(path: Path, rng: Rng) -> Damage:
    """Another kind of file under this name, or no file."""
    contents = {"nothing": b"", "text": b"hello, world\n", "random bytes": rng.bytes(5000), "a zip": b"PK\x03\x04" * 9}
    kind = pick(rng, [*contents, "a folder", "no file", "a link to itself", "a link to nowhere"])
    path.unlink()
    if kind in contents:
        path.write_bytes(contents[kind])
    elif kind == "a folder":
        path.mkdir()
    elif kind != "no file":
        path.symlink_to(path.name if kind == "a link to itself" else "nowhere")
    return Damage(f"replaced by {kind}", illegal=True)


BYTES: tuple[Mutator, ...] = (
    truncate, truncate, flip_bits, flip_bits, overwrite_block, overwrite_block, remove_block, append, replace_whole,
)  # fmt: skip
