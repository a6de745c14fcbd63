"""Small pieces of sentences, and tables for a terminal."""

from __future__ import annotations

import unicodedata
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches
from itertools import pairwise

DURATIONS = (("d", 86400), ("h", 3600), ("min", 60), ("s", 1))
SIZES = (("ZB", 1e21), ("EB", 1e18), ("PB", 1e15), ("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3))


def joined(words: Sequence[str]) -> str:
    """Join words as in a sentence: "a", "a and b", "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def megahertz_of(freqs: Iterable[float]) -> str:
    """List frequencies, Hz, in MHz: "131, 151.2"."""
    return ", ".join(f"{freq / 1e6:.6g}" for freq in freqs)


def from_to(first: str, last: str) -> str:
    """Say from which to which, or the one that both are: "2 to 30", "2"."""
    return first if first == last else f"{first} to {last}"


def did_you_mean(name: str, known: Collection[str]) -> str:
    """Ask for the names that are nearest, before more is said; nothing where none is near."""
    near = " or ".join(f"'{one}'" for one in get_close_matches(name, known, n=2))
    return f"did you mean {near}? " if near else ""


def counted(n: int, what: str) -> str:
    """Count things: "1 parameter", "3 parameters"."""
    return f"{n} {what}{'' if n == 1 else 's'}"


def effect_words(kind: str, law: str | None = None) -> str:
    """Name an effect by its kind, and by the law by which it changes in time if it does: "antenna gains, smooth"."""
    name = kind.replace("_", " ")
    return name if law in (None, "constant") else f"{name}, {law}"


def capital(text: str) -> str:
    """Begin a sentence, leaving all other letters as they are."""
    return f"{text[:1].upper()}{text[1:]}"


def duration(seconds: float) -> str:
    """Write a time as people say it: "3 d 4 h", "12 min", "8.3 s"."""
    for (large, of_large), (small, of_small) in pairwise(DURATIONS):
        if seconds >= of_large:
            whole, rest = divmod(seconds, of_large)
            return f"{whole:.0f} {large}" + (f" {rest // of_small:.0f} {small}" if rest >= of_small else "")
    return f"{round(max(0.0, seconds), 2):.2g} s"


def size(n_bytes: float) -> str:
    """Write a number of bytes in three digits: "656 MB"."""
    for unit, many in SIZES:
        if n_bytes >= 0.9995 * many:
            return f"{n_bytes / many:.3g} {unit}"
    return f"{n_bytes:.0f} B"


def text_table(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> str:
    """Align columns: to the left, but for those of the numbers ``right``."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    ways = [f"{'>' if number in right else '<'}{width}" for number, width in enumerate(widths)]
    return "\n".join("  ".join(map(format, row, ways)).rstrip() for row in rows)


def in_ascii(text: str) -> str:
    """Return text as a FITS header may have it: letters without their accents, and "?" for what ASCII lacks."""
    plain = (letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in plain)
