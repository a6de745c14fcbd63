"""All effects by the names that jobs give them; a new one has a file beside these and its line here."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from pydantic import ConfigDict, TypeAdapter

from hydrabeam_mpi.errors import InputError

if TYPE_CHECKING:
    from hydrabeam_mpi.effects.interface.effect import Cause, CrossPolarised, Effect
    from hydrabeam_mpi.effects.interface.reweighting import Reweighting


Kind = TypeVar("Kind")


class Registry(Mapping[str, type[Kind]]):
    """Classes by name, each imported when it is first asked for.

    The mistakes of a job file are told from the names alone, a second before astropy and pyuvdata are imported.

    Parameters
    ----------
    *modules
        Below this package, a room and a name: the class in "sky.missing_sources" is `MissingSources`.
    """

    def __init__(self, *modules: str) -> None:
        self._modules = {module.rpartition(".")[2]: module for module in modules}

    def __getitem__(self, kind: str) -> type[Kind]:
        module = import_module(f"{__package__}.{self._modules[kind]}")
        of_kind: type[Kind] = getattr(module, kind.title().replace("_", ""))
        return of_kind

    def __iter__(self) -> Iterator[str]:
        return iter(self._modules)

    def __len__(self) -> int:
        return len(self._modules)


EFFECTS: Registry[Effect] = Registry(
    "instrument.antenna_gains",
    "instrument.antenna_delays",
    "instrument.cable_reflections",
    "instrument.cross_coupling",
    "instrument.auto_coupling",
    "instrument.mutual_coupling",
    "sky.missing_sources",
    "sky.catalogue_flux",
    "sky.diffuse",
    "instrument.antenna_positions",
    "instrument.timestamp",
    "instrument.antenna_pointing",
    "instrument.nonredundant_beams",
    "instrument.basis_truncation",
    "sky.ionosphere",
    "sky.horizon",
)
"""Effects that change what the data are expected to be."""

REWEIGHTINGS: Registry[Reweighting] = Registry("noise.noise_level", "noise.outliers")
"""Changes of how much the data weigh."""

SEPARATE: Registry[CrossPolarised] = Registry("instrument.leakage")
"""Causes that are seen in other rows than those of the job's polarisation."""

KINDS = (*EFFECTS, *SEPARATE, *REWEIGHTINGS)
"""All that a job may name."""


def make_effect(kind: str, settings: Mapping[str, Any]) -> Effect:
    """Restore an effect from its kind and what its `describe` returned.

    Raises
    ------
    InputError
        If these are no settings of this kind.
    """
    effect: Effect = _make(EFFECTS[kind], settings)
    return effect


def make_cause(kind: str, settings: Mapping[str, Any]) -> Cause:
    """Do the same for an effect or one that is `SEPARATE`."""
    cause: Cause = _make({**EFFECTS, **SEPARATE}[kind], settings)
    return cause


def make_reweighting(kind: str, settings: Mapping[str, Any]) -> Reweighting:
    """Do the same for a change of the weights."""
    change: Reweighting = _make(REWEIGHTINGS[kind], settings)
    return change


def _make(of_kind: Any, settings: Mapping[str, Any]) -> Any:
    kinds = get_type_hints(of_kind.__init__, include_extras=True)
    try:
        values = {name: _checked(kinds[name], value) if name in kinds else value for name, value in settings.items()}
        return of_kind(**values)
    except (TypeError, ValueError) as error:
        known = ", ".join(inspect.signature(of_kind).parameters)
        remedy = f"there are {known}, as 'hydrabeam loop' writes them" if known else "leave them out"
        raise InputError("are not understood", field="settings", remedy=remedy) from error


def _checked(kind: Any, value: Any) -> Any:
    """Make sure that a setting is what its type says, or raise `ValueError`."""
    return TypeAdapter(kind, config=ConfigDict(allow_inf_nan=False)).validate_python(value)
