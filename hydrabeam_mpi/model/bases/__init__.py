"""The bases by their kinds; a new one has a file here and a line in `BASES`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.registry import Registry

if TYPE_CHECKING:
    from hydrabeam_mpi.model.bases.base import LinearBasis, Selection

MADE_OF_OTHERS = ("joined", "turned", "rest", "with_rest")
BASES: Registry[LinearBasis] = Registry("hydrabeam_mpi.model.bases", "fourier_bessel", "zernike", *MADE_OF_OTHERS)

JOB_NAMES = {kind.replace("_", "-"): kind for kind in BASES if kind not in MADE_OF_OTHERS}
"""What jobs call those that they may ask for."""


def basis_from_settings(settings: Mapping[str, Any]) -> LinearBasis | Selection:
    """Make the basis that a job asks for, or say from which to select modes by the model beam.

    Parameters
    ----------
    settings : mapping
        Keys and values of the job's ``[basis]`` table.

    Raises
    ------
    InputError
        If it is of no known kind.
    """
    name = settings["kind"]
    if name not in JOB_NAMES:
        raise InputError(f"unknown basis {name!r}", field="[basis] kind", remedy=f"known: {', '.join(JOB_NAMES)}")
    return BASES[JOB_NAMES[name]].from_settings(settings)


def basis_from_description(description: Mapping[str, Any]) -> LinearBasis:
    """Restore a basis from what its ``describe`` returned.

    Raises
    ------
    InputError
        If the description is of no known kind or incomplete.
    """
    kind = str(description.get("kind"))
    if kind not in BASES:
        raise InputError(f"unknown basis kind {kind!r}", field="basis", remedy=f"known: {', '.join(BASES)}")
    try:
        if "parts" in description:
            description = {**description, "parts": [basis_from_description(part) for part in description["parts"]]}
        return BASES[kind].from_description(description)
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
        raise InputError(f"incomplete description of a {kind} basis: {error!r}", field="basis") from error
