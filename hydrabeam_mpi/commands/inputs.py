"""Files as a user names them: which of them are visibilities, gains, a beam or a sky."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import h5py
from astropy.io import fits

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.catalogue import file_type
from hydrabeam_mpi.io.manifest import read_manifest
from hydrabeam_mpi.io.reading import check_file, reading
from hydrabeam_mpi.simulation.truth import BEAM, SKY

Role = Literal["data", "gains", "beam", "sky"]
_HDF5, _FITS = b"\x89HDF\r\n\x1a\n", b"SIMPLE  ="
_CALLED: dict[Role, str] = {"gains": "gains", "beam": "a beam", "sky": "a sky"}
_BEAM_SUFFIXES = (".yaml", ".yml", ".ffe")
"""Lists of CST files, and FEKO's."""


@dataclass(frozen=True)
class Inputs:
    """Files by what they are.

    Attributes
    ----------
    data, gains : tuple of Path
    beam, sky : Path, optional
    simulation : Job, optional
        What the data were simulated with.
    """

    data: tuple[Path, ...]
    gains: tuple[Path, ...] = ()
    beam: Path | None = None
    sky: Path | None = None
    simulation: Job | None = None


def sort_inputs(paths: Sequence[Path]) -> Inputs:
    """Tell files apart by their content; beside data of `hydrabeam simulate` its sky is found.

    Raises
    ------
    InputError
        If one cannot be read, none has visibilities, or two are beams or skies.
    """
    found: dict[Role, list[Path]] = {"data": [], "gains": [], "beam": [], "sky": []}
    for path in paths:
        found[role_of(path)].append(path)
    if not found["data"]:
        (is_a,) = (word for role, word in _CALLED.items() if found[role][:1] == [paths[0]])
        raise InputError(f"no visibilities, but {is_a}", file=paths[0], remedy="name their files, too")
    for role, several in (("beam", found["beam"]), ("sky", found["sky"])):
        if len(several) > 1:
            raise InputError(f"a {role}, and so is {several[0].name}", file=several[1], remedy="name one of them")
    beam, sky = (next(iter(found[role]), None) for role in ("beam", "sky"))
    return _with_simulation(Inputs(tuple(found["data"]), tuple(found["gains"]), beam, sky))


def role_of(path: Path) -> Role:
    """Tell what a file holds; where nothing else is known, it is taken for visibilities.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    if os.path.isdir(path):
        return "data"
    check_file(path)
    with path.open("rb") as file:
        magic = file.read(len(_FITS))
    if magic.startswith(_HDF5):
        return _role_of_hdf5(path)
    if magic == _FITS:
        return _role_of_fits(path)
    return "beam" if path.suffix.lower() in _BEAM_SUFFIXES else "sky" if file_type(path) else "data"


def _role_of_hdf5(path: Path) -> Role:
    with reading(path, "HDF5"), h5py.File(path, "r") as file:
        header = file.get("Header", {})
        return "sky" if "component_type" in header else "gains" if "gain_convention" in header else "data"


def _role_of_fits(path: Path) -> Role:
    with reading(path, "FITS"):
        header = fits.getheader(path)
        return "gains" if "CALSTYLE" in header else "beam" if "BTYPE" in header else "data"


def _with_simulation(inputs: Inputs) -> Inputs:
    """Add what a simulation has left beside its data, where these are nothing else."""
    (folder, *others) = {path.absolute().parent for path in inputs.data}
    listed = read_manifest(folder) or {}
    if others or not {SKY, BEAM, "job.toml"} <= listed.keys():
        return inputs
    return replace(inputs, sky=inputs.sky or folder / SKY, simulation=load_job(folder / "job.toml"))
