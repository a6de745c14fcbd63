"""The true sky and beam of a simulation, in files that this and other programs read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.io.beamfits import write_power_beam
from hydrabeam_mpi.io.skyh5 import Spectrum, sky_model
from hydrabeam_mpi.result.summary import evaluate_on_grid
from hydrabeam_mpi.setup.skies import are_apparent
from hydrabeam_mpi.simulation.mock import Scene
from hydrabeam_mpi.version import __version__

if TYPE_CHECKING:
    from pyradiosky import SkyModel

SKY, BEAM = "sky.skyh5", "true_beam.beamfits"


def true_sky(job: Job, scene: Scene) -> SkyModel:
    """Return the sky of a simulation: a power law where the job gives one, else its fluxes at the channels."""
    settings, sky = job.sky, scene.sky
    is_power_law = settings.kind == "mock" and settings.diffuse is None
    index = settings.spectral_index if is_power_law else None
    spectrum = Spectrum(scene.observation.freqs, sky.reference_freq, index)
    return sky_model(sky, spectrum, None if are_apparent(job) else scene.observation)


def write_truth(folder: Path, job: Job, scene: Scene) -> None:
    """Write ``sky.skyh5``, and the true beams on the one-degree grid as ``true_beam.beamfits``."""
    sky = true_sky(job, scene)
    sky.history = f"The sky that hydrabeam_mpi {__version__} simulated data.uvh5 with."
    sky.write_skyh5(str(folder / SKY), clobber=True)
    write_power_beam(
        folder / BEAM,
        np.array([[evaluate_on_grid(beam) for beam in of_pol] for of_pol in scene.beams.values()]),
        scene.observation.freqs,
        list(scene.beams),
        telescope_name=scene.observation.telescope_name,
        history=f"The beam that hydrabeam_mpi {__version__} simulated data.uvh5 with.",
    )
