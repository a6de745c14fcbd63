"""Mock data in memory."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.mistakes import as_input_error
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import read_uvdata
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.mpi import alone
from hydrabeam_mpi.simulation.mock import simulate_to
from hydrabeam_mpi.simulation.truth import true_sky

if TYPE_CHECKING:
    from pyradiosky import SkyModel
    from pyuvdata import UVData


@dataclass(frozen=True)
class Mock:
    """Mock data.

    Attributes
    ----------
    uvd : UVData
        Cross- and autocorrelations, with noise.
    beams : tuple of callable
        The beam of each channel that they were simulated with: ``beam(za, az)``, radians, (Npoints,) each.
    sky : SkyModel
        The sky that they were simulated with. One in coordinates of date goes with ``positions="lst"``.
    """

    uvd: UVData
    beams: tuple[Beam, ...]
    sky: SkyModel


def simulate(job: str | Path | Mapping[str, Any]) -> Mock:
    """Simulate data as in HDBI II, section 3, as `hydrabeam simulate` does. Serial.

    Parameters
    ----------
    job : str, Path or mapping
        A job file with a table ``[data.simulate]``, or the same as a mapping.

    Raises
    ------
    InputError
        If the job cannot be simulated.
    """
    resolved = _job(job) if isinstance(job, Mapping) else load_job(Path(job))
    if resolved.data.simulate is None:
        raise InputError("is missing", field="[data.simulate]", remedy="add it, see jobs/paper/job.toml")
    pol = resolved.data.pol
    with TemporaryDirectory(prefix="hydrabeam-") as folder:
        scene = simulate_to(alone(), resolved, Path(folder))
        uvd = read_uvdata(Path(folder) / "data.uvh5", "uvh5")
    return Mock(uvd, scene.beams[pol], true_sky(resolved, scene))


def _job(content: Mapping[str, Any]) -> Job:
    try:
        return Job.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise as_input_error(error, Job) from error
