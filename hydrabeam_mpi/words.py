"""Small pieces of sentences."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence


def joined(words: Sequence[str]) -> str:
    """Join words as in a sentence: "a", "a and b", "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


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


def in_ascii(text: str) -> str:
    """Return text as a FITS header may have it: letters without their accents, and "?" for what ASCII lacks."""
    plain = (letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in plain)
