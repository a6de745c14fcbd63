"""Result folders, and single files of them, as objects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydrabeam_mpi.api.beam import InferredBeam
from hydrabeam_mpi.api.result import Found, Result
from hydrabeam_mpi.api.results import Results
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.io.formats import read_loop
from hydrabeam_mpi.io.posterior_file import read_posterior
from hydrabeam_mpi.io.reading import read_json
from hydrabeam_mpi.io.together import folders_of_each

REMEDY = "name a folder written by 'hydrabeam infer' or 'hydrabeam loop'"


def load(folder: str | Path) -> Result | Found | Results:
    """Read a result folder, of `hydrabeam infer`, `hydrabeam loop` or ``write``.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    Result
        A `Found` where it is of a loop, `Results` where of several polarisations. Covariances are read when they are
        asked for.

    Raises
    ------
    InputError
        If it is no such folder.
    """
    place = Path(folder)
    if parts := folders_of_each(place):
        return Results(load_job(place / "job.toml"), {pol: load(part) for pol, part in parts.items()})
    content = read_posterior(place / "posterior.h5")
    summary = read_json(place / "summary.json", what="a part of a result", remedy=REMEDY)
    result = Result(load_job(place / "job.toml"), content, summary, place / "posterior.h5")
    if not (place / "loop.json").exists():
        return result
    record = read_loop(place / "loop.json", REMEDY)
    return Found(result, record, place / "amended.toml")


def load_posterior(path: str | Path) -> InferredBeam:
    """Read ``posterior.h5`` alone.

    Raises
    ------
    InputError
        If it cannot be read, or is of a layout that is not known.
    """
    return InferredBeam(read_posterior(Path(path)), Path(path))


def load_loop(path: str | Path) -> dict[str, Any]:
    """Read ``loop.json`` alone: a table as ``hydrabeam_mpi/tables/loop.schema.json`` describes it.

    Raises
    ------
    InputError
        If it cannot be read, or is of a layout that is not known.
    """
    return read_loop(Path(path), REMEDY)
