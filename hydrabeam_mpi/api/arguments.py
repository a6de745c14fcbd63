"""From the arguments of `Setup` to a job and the objects that are in memory."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from pydantic import ValidationError

from hydrabeam_mpi.config import Job, Section
from hydrabeam_mpi.config.mistakes import as_input_error
from hydrabeam_mpi.config.sections import Basis
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.io.inferred import Inferred
from hydrabeam_mpi.setup.given import Given

IN_MEMORY = "in memory: {}"
"""What stands in a job in place of a file's name."""
NAMES = re.compile(r"(uvd(\[\d+\])?|beam|sky|noise|prior)$")
"""What messages call the objects."""


class Tables(TypedDict, total=False):
    """Further tables and keys of a job file, as `hydrabeam init` lists them."""

    noise: Any
    holdout: Mapping[str, Any]
    data: Mapping[str, Any]
    beam_options: Mapping[str, Any]
    sky_options: Mapping[str, Any]
    solver: Mapping[str, Any]
    output: Mapping[str, Any]
    loop: Mapping[str, Any]
    sample: Mapping[str, Any]
    name: str
    seed: int


@contextmanager
def arguments_named() -> Iterator[None]:
    """Tell of what is wrong by the name of the argument, where a job file's key or a file's name would stand."""
    try:
        yield
    except InputError as error:
        if error.file is not None and NAMES.match(error.file):
            argument, error.file = error.file, None
            error.within(argument)
        elif error.field and (key := re.match(r"\[(\w+)(?:\.[\w.]+)?\] ?(.*)", error.field)):
            error.field = None if not key[2] else key[2]
            error.within(key[1])
        raise


def job_of(arguments: Mapping[str, Any], tables: Tables) -> tuple[Job, Given]:
    """Divide the arguments of `Setup` into a job and what is in memory.

    Raises
    ------
    InputError
        If one is of a wrong kind, or a key or value of a job is wrong.
    """
    content: dict[str, Any] = dict(tables)
    data, held = _data(arguments["uvd"])
    content["data"] = {**content.get("data", {}), **data}
    beam, sky = arguments["beam"], arguments["sky"]
    of_beam, beam_held = _table("beam", beam, "source")
    of_sky, sky_held = _table("sky", sky, "file")
    content["beam"] = {**of_beam, **content.pop("beam_options", {})}
    content["sky"] = {**of_sky, **content.pop("sky_options", {})}
    if "file" in content["sky"]:
        content["sky"]["kind"] = "catalogue"
    noise, variance = _noise(content.get("noise"))
    before, basis = arguments["prior"], arguments["basis"]
    if _is_result(before) and basis is None:
        basis = before.job.basis
    prior, priors, earlier = _prior(before)
    content |= {"noise": noise, "prior": prior}
    for name, argument in (("basis", basis), ("holdout", content.get("holdout"))):
        content[name], unknown = _table(name, argument, None)
        if unknown is not None:
            raise _kind(name, unknown, "give a mapping with the keys of that table of a job file")
    try:
        job = Job.model_validate_json(json.dumps(content, default=_plain))
    except ValidationError as error:
        raise as_input_error(error, Job) from error
    _check_objects(beam_held, sky_held)
    if variance is not None and len(held) != 1:
        remedy = "give one UVData, or a file of noise"
        raise InputError("an array of variances goes with one UVData", file="noise", remedy=remedy)
    sigma = None if variance is None else held[0].with_sigma(variance, "noise")
    return job, Given(held, beam_held, sky_held, sigma, priors, earlier)


def FourierBessel(**settings: Any) -> Basis:
    """Return the settings of a Fourier-Bessel basis, f = J0(u_k rho) exp(i m az) / q_k (HDBI II, eq. 5).

    Parameters
    ----------
    **settings
        ``n_modes`` (2048, those with the largest coefficients of the model beam), ``form`` ("real" or "complex"),
        ``k_max`` (80) and ``m_max`` (45): the radial and azimuthal orders; ``edge`` (92, degrees of zenith angle) and
        ``boundary`` there ("neumann" or "dirichlet").

    Raises
    ------
    InputError
        If a setting is unknown, or not what it should be.
    """
    return _basis("fourier-bessel", settings)


def Zernike(**settings: Any) -> Basis:
    """Return the settings of a basis of Zernike polynomials.

    Parameters
    ----------
    **settings
        ``max_degree`` (30) and ``edge`` (92, degrees of zenith angle).

    Raises
    ------
    InputError
        If a setting is unknown, or not what it should be.
    """
    return _basis("zernike", settings)


def _basis(kind: str, settings: Mapping[str, Any]) -> Basis:
    try:
        return Basis.model_validate_json(json.dumps({"kind": kind, **settings}, default=_plain))
    except ValidationError as error:
        told = as_input_error(error, Basis)
        told.within("basis")
        raise told from error


def _data(uvd: Any) -> tuple[dict[str, Any], tuple[Any, ...]]:
    """Return the files, or what stands for them, and the visibilities in memory."""
    several = isinstance(uvd, Sequence) and not isinstance(uvd, str)
    parts = list(uvd) if several else [uvd]
    if parts and all(isinstance(part, str | Path) for part in parts):
        return {"files": [str(part) for part in parts]}, ()
    from pyuvdata import UVData

    from hydrabeam_mpi.io.uvsource import UVInMemory

    if not parts or not all(isinstance(part, UVData) for part in parts):
        wrong = next((part for part in parts if not isinstance(part, UVData)), uvd)
        raise _kind("uvd", wrong, "give a UVData, several, or names of files")
    names = [f"uvd[{number}]" for number in range(len(parts))] if several else ["uvd"]
    held = tuple(UVInMemory.of(part, name) for part, name in zip(parts, names, strict=True))
    return {"files": [IN_MEMORY.format(name) for name in names]}, held


def _table(name: str, argument: Any, file_key: str | None) -> tuple[dict[str, Any], Any]:
    """Return a job's table, and the argument itself where it is an object."""
    if argument is None:
        return {}, None
    if isinstance(argument, Section):
        return argument.model_dump(mode="json", exclude_unset=True), None
    if isinstance(argument, Mapping):
        return dict(argument), None
    if file_key is not None and isinstance(argument, str | Path):
        return {file_key: str(argument)}, None
    return ({file_key: IN_MEMORY.format(name)} if file_key else {}), argument


def _noise(noise: Any) -> tuple[dict[str, Any], Any]:
    """Return the table, and the variances where they are an array."""
    table, variance = _table("noise", noise, "file")
    if "file" in table:
        table["kind"] = "file"
    return table, variance


def _prior(prior: Any) -> tuple[dict[str, Any], list[Prior] | None, Inferred | None]:
    """Return the table, and the priors where they are objects, or the result that is not in a folder."""
    if _is_result(prior) and prior.path is not None:
        prior = prior.path.parent
    table, given = _table("prior", prior, "file")
    if given is None:
        return table, None, None
    if _is_result(given):
        return table, None, Inferred.of(given.content)
    priors = list(given) if isinstance(given, list | tuple) else [given]
    wrong = next((one for one in priors if not hasattr(one, "add_precision")), None)
    if wrong is not None or not priors:
        remedy = "give a mapping, a file's name, a result, or a prior of hydrabeam_mpi.inference.prior"
        raise _kind("prior", wrong, remedy)
    return table, priors, None


def _is_result(prior: Any) -> bool:
    """Whether it is what `infer`, `close_loop` and `load` return."""
    return hasattr(type(prior), "content")


def _check_objects(beam: Any, sky: Any) -> None:
    """Make sure that beam and sky are what the packages of the field have."""
    if beam is not None:
        from pyuvdata import BeamInterface, UVBeam
        from pyuvdata.analytic_beam import AnalyticBeam

        if not isinstance(beam, BeamInterface | UVBeam | AnalyticBeam):
            raise _kind("beam", beam, "give a UVBeam, a BeamInterface, an analytic beam of pyuvdata, or a file's name")
    if sky is not None:
        from pyradiosky import SkyModel

        if not isinstance(sky, SkyModel):
            raise _kind("sky", sky, "give a SkyModel of pyradiosky, a file's name, or the keys of [sky] in a mapping")


def _kind(name: str, wrong: Any, remedy: str) -> InputError:
    return InputError(f"is of type {type(wrong).__name__}", field=name, remedy=remedy)


def _plain(value: Any) -> Any:
    """Return numbers of numpy and names of files as JSON has them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value.model_dump(mode="json", exclude_unset=True) if isinstance(value, Section) else str(value)
