"""A result folder as the report needs it: ``posterior.h5`` and ``summary.json`` side by side."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.kept_rounds import check_ended
from hydrabeam_mpi.io.posterior_file import PosteriorFile, read_covariance, read_posterior
from hydrabeam_mpi.io.reading import read_json
from hydrabeam_mpi.io.together import check_of_one

REMEDY = "name a folder written by 'hydrabeam infer'"
OLDER = {"heldout_chi2": "heldout_chi2_noise_only"}
"""What key numbers were called before."""


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel of a result.

    Attributes
    ----------
    number : int
        Its place in ``posterior.h5``.
    freq : float
        Hz.
    numbers : dict
        Its key numbers, named as in ``summary.json``; any may be absent.
    arrays : dict of ndarray
        Its data sets, named as in ``posterior.h5``, without the covariance; maps and scores may be absent.
    basis : dict
        Description of the basis.
    za, az : ndarray
        The grid of the maps, radians.
    path : Path
        Of ``posterior.h5``.
    effects : list of dict
        Those of the model that have parameters, as in a job's ``[[effects]]``.
    """

    number: int
    freq: float
    numbers: dict[str, Any]
    arrays: dict[str, Array]
    basis: dict[str, Any]
    za: Array
    az: Array
    path: Path
    effects: Sequence[dict[str, Any]] = ()

    @property
    def is_complex(self) -> bool:
        """Whether the coefficients are complex."""
        return self.arrays["mean"].dtype.kind == "c"

    @property
    def truth(self) -> Array | None:
        """The beam that the data were simulated with on the grid, (Nza, Naz), or None."""
        return self.arrays.get("map_truth")

    def covariance(self) -> Array:
        """Read the posterior covariance, (n, n)."""
        return read_covariance(self.path, self.number)


@dataclass(frozen=True, eq=False)
class Result:
    """What ``hydrabeam infer`` left in a folder.

    Attributes
    ----------
    name : str
        Of the job.
    numbers : dict
        Key numbers of the whole run.
    warnings : list of str
        What the run itself had to say.
    channels : list of Channel
        In the order of ``posterior.h5``.
    provenance : dict
        Resolved job, versions, checksums, ranks.
    polarization : str
    observed : dict of ndarray
        What was observed, named as in ``posterior.h5``; empty of results that were written before it was kept.
    """

    name: str
    numbers: dict[str, Any]
    warnings: list[str]
    channels: list[Channel]
    provenance: dict[str, Any]
    polarization: str
    observed: dict[str, Array]


def load_result(directory: Path) -> Result:
    """Read a result folder; covariances stay on disk.

    Raises
    ------
    InputError
        If the folder or one of its two files is missing or not what it should be.
    """
    if not directory.is_dir():
        raise InputError("no such folder", file=directory, remedy=REMEDY)
    check_ended(directory)
    check_of_one(directory)
    summary = _read_summary(directory / "summary.json")
    path = directory / "posterior.h5"
    posterior = read_posterior(path)
    per_channel = summary.pop("channels", None) or [{}] * len(posterior.channels)
    warnings = summary.pop("warnings", None) or []
    for field, entries, kind in (("channels", per_channel, dict), ("warnings", warnings, str)):
        if not isinstance(entries, list) or not all(isinstance(entry, kind) for entry in entries):
            told = "is not a list of tables" if kind is dict else "is not a list of texts"
            raise InputError(told, file=directory / "summary.json", field=field, remedy=REMEDY)
    if not posterior.channels or len(per_channel) != len(posterior.channels):
        raise InputError(
            f"has {len(per_channel)} channels, posterior.h5 has {len(posterior.channels)}",
            file=directory / "summary.json",
            field="channels",
            remedy="both files must come from the same run",
        )
    channels = [_channel(posterior, number, numbers, path) for number, numbers in enumerate(per_channel)]
    name = str(summary.pop("name", Path(os.path.realpath(directory)).name))
    return Result(
        name, renamed(summary), warnings, channels, posterior.provenance, posterior.polarization, posterior.observed
    )


def _read_summary(path: Path) -> dict[str, Any]:
    summary = read_json(path, remedy=REMEDY)
    phases = summary.get("phases_s") or {}
    if not isinstance(phases, dict) or not all(isinstance(seconds, int | float) for seconds in phases.values()):
        raise InputError("is not a table of seconds", file=path, field="phases_s", remedy=REMEDY)
    return summary


def renamed(numbers: dict[str, Any]) -> dict[str, Any]:
    """Return key numbers by the names that they have now, in results of earlier versions, too."""
    older = {key: value for key, value in numbers.items() if key in OLDER}
    return {OLDER[key]: value for key, value in older.items()} | {
        key: value for key, value in numbers.items() if key not in OLDER
    }


def _channel(posterior: PosteriorFile, number: int, numbers: dict[str, Any], path: Path) -> Channel:
    record = posterior.channels[number]
    known = renamed({**record.summary, **numbers})
    if record.log_evidence is not None:
        known.setdefault("log_evidence", record.log_evidence)
    grid = posterior.grid_za, posterior.grid_az
    effects = [entry for entry in (posterior.effects or {}).get("entries", ()) if entry.get("names")]
    return Channel(number, record.freq, known, record.arrays, posterior.basis, *grid, path, effects)
