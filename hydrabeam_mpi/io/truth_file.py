"""``truth.h5``: what a simulation was made with, to compare an inference with."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.io.formats import FORMAT, check_format, describe
from hydrabeam_mpi.io.hdf5 import new_hdf5
from hydrabeam_mpi.io.reading import check_file, reading

TRUTH_FORMAT = 1
REMEDY = "name a truth.h5 written by 'hydrabeam simulate'"
DATA_SETS = {
    "freqs": ("Hz", "frequency of each channel"),
    "grid_za": ("rad", "zenith angle of the beams"),
    "grid_az": ("rad", "azimuth of the beams, from East through North"),
    "beam": ("1", "true power beam of each channel"),
    "ra": ("rad", "right ascension of the sources"),
    "dec": ("rad", "declination of the sources"),
    "flux": ("Jy", "flux density of the sources in each channel"),
}
"""Unit and name of each data set."""


@dataclass(frozen=True)
class Truth:
    """What a simulation was made with.

    Attributes
    ----------
    freqs : ndarray, (Nfreqs,)
        Hz.
    grid_za, grid_az : ndarray, (91,) and (360,)
        Radians; azimuth from East through North.
    beam : ndarray, (Nfreqs, 91, 360)
        The true power beam of the job's polarisation.
    ra, dec : ndarray, (Nsources,)
        Radians.
    flux : ndarray, (Nfreqs, Nsources)
        Jy.
    beam_names : sequence of str
        Of each channel.
    polarization : str
    effects : sequence of dict
        What was injected: kind, and names and values of its parameters.
    """

    freqs: FloatArray
    grid_za: FloatArray
    grid_az: FloatArray
    beam: FloatArray
    ra: FloatArray
    dec: FloatArray
    flux: FloatArray
    beam_names: Sequence[str]
    polarization: str
    effects: Sequence[dict[str, Any]]


def write_truth(path: Path, truth: Truth) -> None:
    """Write ``truth.h5``.

    Raises
    ------
    OSError
        If not all of it could be written.
    """
    with new_hdf5(path) as file:
        file.attrs[FORMAT] = TRUTH_FORMAT
        for name, told in DATA_SETS.items():
            file[name] = getattr(truth, name)
            describe(file[name], *told)
        file.attrs["beam_names"] = list(truth.beam_names)
        file.attrs["polarization"] = truth.polarization
        file.attrs["effects"] = json.dumps(truth.effects)


def load_truth(path: str | Path) -> Truth:
    """Read ``truth.h5``, which `hydrabeam simulate` wrote.

    Raises
    ------
    InputError
        If it cannot be read, or is of a layout that is not known.
    """
    path = Path(path)
    check_file(path, remedy=REMEDY)
    with reading(path, "the truth of a simulation", remedy=REMEDY), h5py.File(path, "r") as file:
        check_format(file.attrs.get(FORMAT), TRUTH_FORMAT)
        arrays = {field.name: np.asarray(file[field.name][()]) for field in fields(Truth) if field.name in DATA_SETS}
        return Truth(
            **arrays,
            beam_names=[str(name) for name in file.attrs["beam_names"]],
            polarization=str(file.attrs["polarization"]),
            effects=json.loads(file.attrs["effects"]),
        )
