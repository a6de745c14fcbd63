"""What was inferred, and what a loop found: just computed, or read from a result folder."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.posterior_file import PosteriorFile, read_covariance, read_posterior
from hydrabeam_mpi.io.reading import reading
from hydrabeam_mpi.model.bases import basis_from_description
from hydrabeam_mpi.random import complex_normal, generator

if TYPE_CHECKING:
    from pyuvdata import UVBeam

    from hydrabeam_mpi.api.setup import Setup

REMEDY = "name a folder written by 'hydrabeam infer' or 'hydrabeam loop'"


class InferredBeam:
    """The posterior of the beam's coefficients, a Gaussian in each channel.

    Parameters
    ----------
    content : PosteriorFile
    path : Path, optional
        The file from which covariances are read when they are asked for, where the channels have none.

    Attributes
    ----------
    basis : LinearBasis
    freqs : ndarray, (Nfreqs,)
        Hz.
    polarization : str
    """

    def __init__(self, content: PosteriorFile, path: Path | None = None) -> None:
        self._content, self._path = content, path
        self.basis = basis_from_description(content.basis)
        self.freqs = np.array([record.freq for record in content.channels])
        self.polarization = content.polarization

    def _stacked(self, name: str) -> Array:
        return np.array([record.arrays[name] for record in self._content.channels])

    @cached_property
    def mean(self) -> Array:
        """Posterior mean of the coefficients, (Nfreqs, n_modes)."""
        return self._stacked("mean")

    @cached_property
    def std(self) -> FloatArray:
        """Posterior standard deviation of the coefficients, (Nfreqs, n_modes)."""
        return self._stacked("std")

    @cached_property
    def covariance(self) -> Array:
        """E[(b - mean)(b - mean)^H], (Nfreqs, n_modes, n_modes); read from the file when first asked for."""
        if self._path is None:
            return self._stacked("covariance")
        return np.array([read_covariance(self._path, channel) for channel in range(len(self.freqs))])

    @property
    def maps(self) -> dict[str, Array]:
        """Beams on the one-degree grid, (Nfreqs, 91, 360), zenith angle first: mean, std, model and any truth."""
        names = ("mean", "std", "model", "truth")
        held = self._content.channels[0].arrays
        return {name: self._stacked(f"map_{name}") for name in names if f"map_{name}" in held}

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Return the mean beam in some directions.

        Parameters
        ----------
        za, az : ndarray, (Npoints,)
            Zenith angle, and azimuth from East through North, in radians.

        Returns
        -------
        ndarray, (Nfreqs, Npoints)
        """
        return np.array([self.basis.synthesize(mean, np.asarray(za), np.asarray(az)) for mean in self.mean])

    def draw(self, n: int, seed: int = 0) -> Array:
        """Draw coefficients from the posterior: those of ``posterior.h5`` where the seed is the job's.

        Parameters
        ----------
        n : int
        seed : int

        Returns
        -------
        ndarray, (n, Nfreqs, n_modes)
        """
        draws = np.empty((n, *self.mean.shape), self.mean.dtype)
        for channel, (mean, covariance) in enumerate(zip(self.mean, self.covariance, strict=True)):
            # The upper root C = M M^H, which is the inverse of the factor L^H of the precision, as draws are written.
            root = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]
            for number in range(n):
                rng = generator(seed, "posterior draw", channel, number)
                white = complex_normal(rng, mean.shape) if np.iscomplexobj(mean) else rng.standard_normal(len(mean))
                draws[number, channel] = mean + root @ white
        return draws

    def to_uvbeam(self) -> UVBeam:
        """Return the maximum a posteriori power beam on the one-degree grid, all channels in one UVBeam.

        Its real part, as of a power beam; the largest imaginary part is its keyword IMAGMAX.
        """
        from hydrabeam_mpi.io.beamfits import power_uvbeam
        from hydrabeam_mpi.result.output import map_beams

        return power_uvbeam(**map_beams(self._content))


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
            self._write(Path(folder), overwrite)

    def _write(self, folder: Path, overwrite: bool) -> None:
        from hydrabeam_mpi.io.staging import StagedDirectory

        kept = [Path(name) for name in self.content.provenance.get("sha256", {})]
        staged = StagedDirectory(folder, overwrite, kept=kept)
        try:
            self.fill(staged.partial)
        except BaseException:
            staged.discard()
            raise
        staged.publish()

    def fill(self, folder: Path) -> None:
        """Write all files into an empty folder."""
        from hydrabeam_mpi.io.disk import write_computed
        from hydrabeam_mpi.result.output import write_conversions

        write_computed(folder, self.write_files)
        write_conversions(folder, self.content)

    def write_files(self, folder: Path) -> None:
        """Write what has been computed."""
        from hydrabeam_mpi.result.output import write_result

        for record, covariance in zip(self.content.channels, self.beam.covariance, strict=True):
            record.arrays.setdefault("covariance", covariance)
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
    result = Result(load_job(place / "job.toml"), content, _read_json(place / "summary.json"), place / "posterior.h5")
    if not (place / "loop.json").exists():
        return result
    return Found(result, _read_json(place / "loop.json"), place / "amended.toml")


def _read_json(path: Path) -> dict[str, Any]:
    with reading(path, "a part of a result", remedy=REMEDY):
        table = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(table, dict):
        raise InputError("is not a table", file=path, remedy=REMEDY)
    return table
