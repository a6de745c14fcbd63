"""The job file as a whole."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import ValidationError

from hydrabeam_mpi.config.base import Section, key
from hydrabeam_mpi.config.data import Data
from hydrabeam_mpi.config.effects import Effect, Loop
from hydrabeam_mpi.config.mistakes import as_input_error
from hydrabeam_mpi.config.sample import Sample
from hydrabeam_mpi.config.sections import Basis, Beam, Holdout, Noise, Output, Prior, Sky, Solver
from hydrabeam_mpi.config.toml import read_toml


class Job(Section):
    """A whole job file."""

    name: str = key("job", "for titles")
    seed: int = key(0, "of every random number", ge=0)
    data: Data
    noise: Noise = Noise()
    holdout: Holdout = Holdout()
    sky: Sky = Sky()
    beam: Beam = Beam()
    basis: Basis = Basis()
    prior: Prior = Prior()
    solver: Solver = Solver()
    output: Output = Output()
    loop: Loop = Loop()
    sample: Sample = Sample()
    effects: tuple[Effect, ...] = ()


def load_job(path: Path) -> Job:
    """Read and validate a job file; file names in it are relative to its folder.

    Raises
    ------
    InputError
        If it cannot be read, is not TOML, or a key is unknown, missing or of the wrong type or unit.
    """
    content = read_toml(path)
    try:
        # As JSON: lists and texts become tuples and paths, and no other type is taken for another.
        return Job.model_validate_json(content, context={"folder": Path(os.path.realpath(path)).parent})
    except ValidationError as error:
        raise as_input_error(error, Job, path) from error
