"""The folder of several polarisations that were inferred together: in it each has a result folder of its own."""

from __future__ import annotations

import json
from pathlib import Path

from hydrabeam_mpi.errors import InputError

POLARIZATIONS = "polarizations"
"""Key of ``summary.json`` under which they are."""


def folders_of_each(folder: Path) -> dict[str, Path]:
    """Return the results by polarisation; none where the folder is not of several."""
    if (folder / "posterior.h5").exists():
        return {}
    try:
        told = json.loads((folder / "summary.json").read_text(encoding="utf-8"))[POLARIZATIONS]
    except (OSError, ValueError, LookupError, TypeError):
        return {}
    return {pol: folder / pol for pol in told} if isinstance(told, dict) else {}


def check_of_one(folder: Path, field: str | None = None) -> None:
    """Make sure that a folder is not of several polarisations.

    Raises
    ------
    InputError
        If it is.
    """
    if parts := folders_of_each(folder):
        remedy = f"name {' or '.join(map(str, parts.values()))}"
        raise InputError(f"has results of {', '.join(parts)}", file=folder, field=field, remedy=remedy)
