"""The pieces that a page is made of, by the templates beside; text is escaped where it goes in."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

SIGNS = {"chi^2": "χ²", " -> ": " → ", " +- ": " ± "}


def as_html(text: str) -> Markup:
    """Escape text and set its powers of ten, such as 4.5e-6, and its signs as one writes them by hand."""
    if isinstance(text, Markup):
        return text
    for plain, sign in SIGNS.items():
        text = text.replace(plain, sign)

    def power(match: re.Match[str]) -> str:
        mantissa, exponent = match[1], str(int(match[2])).replace("-", "−")
        return f"{'' if mantissa == '1' else f'{mantissa} × '}10<sup>{exponent}</sup>"

    signed = re.sub(r"(?<![\w.])-(?=\d)", "−", str(escape(text)))
    return Markup(re.sub(r"(?<![\w.])(?<![\w.]-)(\d+(?:\.\d+)?)e([+-]?\d+)\b", power, signed))


_TEMPLATES = Environment(
    loader=PackageLoader("hydrabeam_mpi.report.page"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters["signs"] = as_html


@dataclass(frozen=True)
class Section:
    """A part of the page with a heading, to which its contents link; left out where it is empty."""

    title: str
    body: Markup

    @property
    def name(self) -> str:
        """What links to it say."""
        return re.sub(r"\W+", "-", self.title.lower()).strip("-")


@dataclass(frozen=True)
class Answer:
    """What the page begins with.

    Attributes
    ----------
    sentence : str
        What came out.
    table : Markup
        The error before and after.
    picture : Markup
        The beam with its uncertainty.
    warnings : list of str
        What a reader must not overlook.
    """

    sentence: str
    table: Markup
    picture: Markup
    warnings: list[str]


def set_page(title: str, answer: Answer, sections: Sequence[Section], footer: str) -> str:
    """Set a whole page."""
    shown = [section for section in sections if section.body]
    return _TEMPLATES.get_template("page.html").render(title=title, answer=answer, sections=shown, footer=footer)


def part(name: str, *values: Any) -> Markup:
    """Set one of the pieces of ``templates/parts.html``."""
    return Markup(getattr(_TEMPLATES.get_template("parts.html").module, name)(*values))


def together(*parts: Markup) -> Markup:
    """Put pieces one after the other."""
    return Markup("").join(parts)


def under(title: str, inside: Markup) -> Markup:
    """Put a heading above what is inside; nothing where there is nothing."""
    return part("headed", title, inside) if inside else inside


def bullets(lines: Sequence[str], before: str = "") -> Markup:
    """Set lines as a list, with a sentence before it; nothing without lines."""
    return together(part("paragraph", before), part("bullets", lines)) if lines else Markup()


def set_table(
    names: Sequence[str], rows: Sequence[Sequence[str]], values: Collection[int], kind: str = "channels"
) -> Markup:
    """Set a table of these columns, of which ``values`` hold numbers; for short rows see the template."""
    return part("table", names, rows, values, kind)
