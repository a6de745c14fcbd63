"""What was inferred, and what a loop found: just computed, or read from a result folder."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hydrabeam_mpi.api.beam import InferredBeam
from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.io.formats import read_loop
from hydrabeam_mpi.io.posterior_file import PosteriorFile, read_posterior
from hydrabeam_mpi.io.reading import read_json

if TYPE_CHECKING:
    from hydrabeam_mpi.api.setup import Setup

REMEDY = "name a folder written by 'hydrabeam infer' or 'hydrabeam loop'"


class Result:
    """What was inferred.

    On ranks other than 0 there is nothing in it but the job.

    Parameters
    ----------
    job : Job
        The resolved job.
    content : PosteriorFile, optional
    summary : dict, optional
    path : Path, optional
        ``posterior.h5`` of the folder that it was read from.
    """

    def __init__(
        self,
        job: Job,
        content: PosteriorFile | None = None,
        summary: dict[str, Any] | None = None,
        path: Path | None = None,
    ) -> None:
        self.job = job
        self._content, self._summary, self._path = content, summary or {}, path

    @property
    def content(self) -> PosteriorFile:
        """What ``posterior.h5`` holds."""
        if self._content is None:
            raise RuntimeError("the result is on rank 0 alone")
        return self._content

    @property
    def path(self) -> Path | None:
        """``posterior.h5`` of the folder that it was read from, where it was."""
        return self._path

    @property
    def files(self) -> list[Path]:
        """What is read of a result folder."""
        names = ("posterior.h5", "job.toml", "summary.json")
        return [self._path.with_name(name) for name in names] if self._path else []

    @cached_property
    def beam(self) -> InferredBeam:
        """The posterior of the beam."""
        return InferredBeam(self.content, self._path)

    @property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` says: key numbers of the first channel, ``channels`` for all, ``warnings``."""
        return self._summary

    @property
    def heldout(self) -> dict[str, FloatArray]:
        """How held-out data are predicted: ``chi2_predictive``, ``chi2_noise_only`` and others, (Nfreqs,) each.

        Reduced chi^2 under the posterior predictive is 1 for a right posterior. NaN where a channel has no such data.
        """
        channels = [record.summary for record in self.content.channels]
        names = dict.fromkeys(name for channel in channels for name in channel if name.startswith("heldout_"))
        return {
            name.removeprefix("heldout_"): np.array([channel.get(name, np.nan) for channel in channels], dtype=float)
            for name in names
        }

    def write(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write the result folder as `hydrabeam infer` does; by rank 0 alone.

        Raises
        ------
        InputError
            If the folder exists and may not be replaced, or cannot be written.
        """
        if self._content is not None:
            from hydrabeam_mpi.io.staging import write_whole

            write_whole(Path(folder), self.fill, overwrite, map(Path, self.content.provenance.get("sha256", {})))

    def fill(self, folder: Path) -> None:
        """Write all files into an empty folder."""
        from hydrabeam_mpi.io.disk import write_computed
        from hydrabeam_mpi.io.stored import drop_stored
        from hydrabeam_mpi.result.output import write_conversions

        write_computed(folder, self.write_files)
        drop_stored(folder)
        write_conversions(folder, self.content)

    def write_files(self, folder: Path) -> None:
        """Write what has been computed."""
        from hydrabeam_mpi.result.output import write_result

        for number, record in enumerate(self.content.channels):
            for name in ("covariance", "information") if "score" in record.arrays else ("covariance",):
                if name not in record.arrays:
                    record.arrays[name] = self.beam.matrix(number, name)
        write_result(folder, self.job, self.content, self.summary)


class Found(Result):
    """What a loop found, with the result of the amended model.

    On ranks other than 0 there is nothing in it but the job.

    Parameters
    ----------
    result : Result
        Of the amended model.
    record : dict, optional
        What ``loop.json`` says.
    amended : Setup or Path, optional
        The same data with the effects in the model, or the job file that has them.
    """

    def __init__(
        self, result: Result, record: dict[str, Any] | None = None, amended: Setup | Path | None = None
    ) -> None:
        super().__init__(result.job, result._content, result._summary, result._path)
        self.result, self._record, self._amended = result, record, amended

    @property
    def record(self) -> dict[str, Any]:
        """What ``loop.json`` says."""
        if self._record is None:
            raise RuntimeError("the result is on rank 0 alone")
        return self._record

    @property
    def rounds(self) -> list[dict[str, Any]]:
        """The rounds in which something was found: ``effect``, ``sentence``, ``parameters`` and others."""
        rounds: list[dict[str, Any]] = self.record["rounds"]
        return rounds

    @property
    def verdict(self) -> str:
        """One of "consistent", "explained", "unexplained", "convention"."""
        return str(self.record["verdict"])

    @cached_property
    def amended(self) -> Setup:
        """The same data with the effects in the model, for `infer`."""
        from hydrabeam_mpi.api.setup import Setup

        if isinstance(self._amended, Path):
            return Setup.from_job(self._amended)
        if self._amended is None:
            raise RuntimeError("the result is on rank 0 alone")
        return self._amended

    def write_files(self, folder: Path) -> None:
        """Write what has been computed, and what the loop found."""
        from hydrabeam_mpi.loop.output.resume import loop_texts

        super().write_files(folder)
        for name, text in loop_texts(self.record, self.amended.job).items():
            (folder / name).write_text(text)


def load(folder: str | Path) -> Result | Found:
    """Read a result folder, of `hydrabeam infer`, `hydrabeam loop` or ``write``.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    Result
        A `Found` where it is of a loop. Covariances are read when they are asked for.

    Raises
    ------
    InputError
        If it is no such folder.
    """
    place = Path(folder)
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
