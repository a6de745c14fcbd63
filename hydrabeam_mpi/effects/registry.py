"""All effects by the names that jobs give them; a new one has a file beside these and its line here."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.registry import Registry

if TYPE_CHECKING:
    from hydrabeam_mpi.effects.interface.cross_polarised import CrossPolarised
    from hydrabeam_mpi.effects.interface.effect import Cause, Effect
    from hydrabeam_mpi.effects.interface.reweighting import Reweighting


EFFECTS: Registry[Effect] = Registry(
    "hydrabeam_mpi.effects",
    "instrument.antenna_gains",
    "instrument.antenna_delays",
    "instrument.cable_reflections",
    "instrument.cross_coupling",
    "instrument.auto_coupling",
    "instrument.mutual_coupling",
    "instrument.closure_errors",
    "sky.missing_sources",
    "sky.catalogue_flux",
    "sky.spectral_index",
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

REWEIGHTINGS: Registry[Reweighting] = Registry("hydrabeam_mpi.effects", "noise.noise_level", "noise.outliers")
"""Changes of how much the data weigh."""

SEPARATE: Registry[CrossPolarised] = Registry("hydrabeam_mpi.effects", "instrument.leakage")
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
