"""What a job file may say: each table with its keys, their defaults, units and meanings."""

from __future__ import annotations

from collections.abc import Iterator

from hydrabeam_mpi.config import Job, Section
from hydrabeam_mpi.config.text import keys_text, table_text, tables_of
from hydrabeam_mpi.errors import InputError, printable
from hydrabeam_mpi.words import did_you_mean


def all_tables(section: type[Section] = Job, within: str = "") -> Iterator[tuple[str, type[Section]]]:
    """Return the tables of a job with their headers, without the outer brackets: those within one come after it."""
    for name, (table, is_list) in tables_of(section).items():
        path = f"{within}.{name}".lstrip(".")
        yield (f"[{path}]" if is_list else path), table
        yield from all_tables(table, path)


def keys_of(wanted: str | None) -> str:
    """Return all keys as a job file, or those of one table and the tables within it.

    Raises
    ------
    InputError
        If there is no such table.
    """
    tables = {header.strip("[]"): (header, table) for header, table in all_tables()}
    if wanted is None:
        chosen, lines = list(tables.values()), keys_text(Job, {})
    else:
        name = wanted.strip("[]")
        if name not in tables:
            remedy = f"{did_you_mean(name, tables)}one of {', '.join(tables)}"
            raise InputError(f"no table '{printable(wanted)}' in a job", field="keys", remedy=remedy)
        chosen = [one for path, one in tables.items() if path == name or path.startswith(f"{name}.")]
        lines = []
    for header, table in chosen:
        lines += table_text(header, table, {})
    return "\n".join(lines).strip()


def print_keys(wanted: str | None) -> None:
    """Print them."""
    print(keys_of(wanted))
