"""What was inferred, and what a loop found, whether just computed or in a result folder."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hydrabeam_mpi.api.beam import InferredBeam
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.io.posterior_file import PosteriorFile

if TYPE_CHECKING:
    from hydrabeam_mpi.api.setup import Setup


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
    def polarizations(self) -> tuple[str, ...]:
        """Those that there are results of, as the job names them."""
        return self.job.data.polarization

    def __getitem__(self, pol: str) -> Result:
        """Return the result of one polarisation."""
        if pol not in self.polarizations:
            raise KeyError(pol)
        return self

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
        """What ``summary.json`` says: key numbers of the first channel, ``channels`` for all, ``warnings``.

        Among the numbers are ``freq_hz``, ``n_data``, ``n_modes``, ``log_evidence``, ``posterior_std_median``,
        ``condition_number``, ``beam_std_median``, ``beam_update_max``, and those of `heldout` with ``heldout_`` before
        their names; the documentation of result files explains them all.
        """
        return self._summary

    @property
    def heldout(self) -> dict[str, FloatArray]:
        """How held-out data are predicted, (Nfreqs,) each; NaN where a channel has no such data.

        ``n`` counts the visibilities. ``chi2_predictive`` is their reduced chi^2 under the posterior predictive, 1 for
        a right posterior, ``chi2_noise_only`` that over the noise alone, and ``log_density`` the ln of the predictive
        density. ``rms_jy`` is the rms of the residual, Jy, and ``explained`` the fraction of the variance that is
        explained; ``rms_jy_data`` and ``rms_jy_noise`` are of the data and of the noise. With ``_unperturbed`` behind
        its name a number is of the model beam, with ``_unperturbed_scaled`` of that times ``amplitude_unperturbed``,
        its best real scale, and with ``_unperturbed_complex`` of that times its best complex one.
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
        if (inputs := self.inputs) is not None:
            from hydrabeam_mpi.io.staging import write_folder

            write_folder(Path(folder), self.fill, overwrite, inputs)

    @property
    def inputs(self) -> list[Path] | None:
        """The files that it was made from; None on ranks other than 0."""
        return None if self._content is None else list(map(Path, self.content.provenance.get("sha256", {})))

    def fill(self, folder: Path) -> None:
        """Write all files into an empty folder."""
        from hydrabeam_mpi.io.disk import write_computed

        write_computed(folder, self.write_files)
        self.finish(folder)

    def finish(self, folder: Path) -> None:
        """Write what follows from what has been computed and written."""
        from hydrabeam_mpi.io.stored import drop_stored
        from hydrabeam_mpi.result.output import write_conversions

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
