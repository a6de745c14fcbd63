"""What was inferred of several polarisations together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.posterior_file import PosteriorFile


class Results(Result):
    """What was inferred of several polarisations together: ``results["nn"]`` is the `Result` of one.

    Parameters
    ----------
    job : Job
        Of all of them.
    parts : mapping of str to Result
        By polarisation.
    """

    def __init__(self, job: Job, parts: Mapping[str, Result]) -> None:
        super().__init__(job)
        self._parts = dict(parts)

    def __getitem__(self, pol: str) -> Result:
        """Return the result of one polarisation."""
        return self._parts[pol]

    @property
    def content(self) -> PosteriorFile:
        """None of its own."""
        pols = list(self._parts)
        message = f"is of {' and '.join(pols)}, each with a beam of its own"
        raise InputError(message, field="result", remedy=f'take one of them, as by result["{pols[0]}"]')

    @property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` says: key numbers of the first channel under ``polarizations``, and ``warnings``."""
        from hydrabeam_mpi.result.together import summarise_together

        told = {pol: one.summary for pol, one in self._parts.items()}
        return summarise_together(told) if all(told.values()) else {}

    @property
    def files(self) -> list[Path]:
        """What is read of the result folders."""
        return [path for one in self._parts.values() for path in one.files]

    @property
    def inputs(self) -> list[Path] | None:
        """The files that all were made from; None on ranks other than 0."""
        return next(iter(self._parts.values())).inputs

    def write_files(self, folder: Path) -> None:
        """Write what has been computed, of each polarisation into a folder of its own."""
        from hydrabeam_mpi.result.together import write_together

        for pol, one in self._parts.items():
            (folder / pol).mkdir(exist_ok=True)
            one.write_files(folder / pol)
        write_together(folder, self.job, self._contents, self.summary)

    def finish(self, folder: Path) -> None:
        """Write beams as other programs read them, and the manifests that make results of the folders."""
        from hydrabeam_mpi.io.manifest import write_manifest
        from hydrabeam_mpi.result.output import write_beams

        for pol, one in self._parts.items():
            one.finish(folder / pol)
            write_manifest(folder / pol)
        write_beams(folder, self._contents)

    @property
    def _contents(self) -> list[PosteriorFile]:
        return [one.content for one in self._parts.values()]
