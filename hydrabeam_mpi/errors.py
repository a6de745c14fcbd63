"""The one exception that means: the input is wrong, and here is what to do about it."""

from __future__ import annotations

from pathlib import Path

LONGEST = 500
"""Characters of a part of a message, such as a path: six lines of a terminal."""


class InputError(Exception):
    """Input that cannot be used, told in one line.

    Parameters
    ----------
    message : str
        What is wrong.
    file : object, optional
        The file in which it is wrong, or what else has a name as text.
    field : str, optional
        The field, key or column in which it is wrong.
    remedy : str, optional
        What the user can do about it.
    """

    def __init__(
        self,
        message: str,
        *,
        file: object = None,
        field: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.field = field
        self.remedy = remedy
        super().__init__()
        self._compose()

    def locate(self, file: str | Path) -> None:
        """Name the file in which ``field`` is wrong, where no file has been named yet."""
        if self.file is None:
            self.file = str(file)
            self._compose()

    def within(self, table: str) -> None:
        """Name the table in which ``field`` is wrong."""
        self.field = f"{table} {self.field}" if self.field else table
        self._compose()

    def _compose(self) -> None:
        parts = (self.file, self.field, self.message)
        line = ": ".join(_shortened(part) for part in parts if part)
        line = f"{line}; {self.remedy}" if self.remedy else line
        # One line whatever a library put into its message.
        self.args = (printable(" ".join(line.split())),)


def _shortened(text: str) -> str:
    """Cut what was taken out of a file in place of a number or a name, and may be as long as the file."""
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def printable(text: str) -> str:
    """Write out as escapes what a terminal or a text file would obey and not show, such as a line feed or ESC.

    For text that comes from files. What is left shows as it is, whatever its script.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
