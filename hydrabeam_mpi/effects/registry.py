"""All effects by the names that jobs give them; a new one has a file beside these and its line here."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
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
    "instrument.gain_jitter",
    "instrument.compression",
    "instrument.saturation",
    "instrument.ground_emitter",
    "sky.missing_sources",
    "sky.faint_sources",
    "sky.moving_sources",
    "sky.catalogue_flux",
    "sky.source_positions",
    "sky.spectral_index",
    "sky.polarised_sources",
    "sky.resolved_source",
    "sky.elongated_source",
    "sky.diffuse",
    "instrument.antenna_positions",
    "instrument.timestamp",
    "instrument.orientation",
    "instrument.array_scale",
    "instrument.smearing",
    "instrument.antenna_pointing",
    "instrument.nonredundant_beams",
    "instrument.basis_truncation",
    "instrument.common_beam",
    "sky.ionosphere",
    "sky.horizon",
)
"""Effects that change what the data are expected to be."""

REWEIGHTINGS: Registry[Reweighting] = Registry(
    "hydrabeam_mpi.effects",
    "noise.noise_level",
    "noise.outliers",
    "noise.bad_integrations",
    "noise.unknown_integrations",
    "noise.bad_baselines",
)
"""Changes of how much the data weigh."""

SEPARATE: Registry[CrossPolarised] = Registry("hydrabeam_mpi.effects", "instrument.leakage")
"""Causes that are seen in other rows than those of the job's polarisation."""

CONSTANT = "constant"
"""The law of what is the same at all times."""

KINDS = (*EFFECTS, *SEPARATE, *REWEIGHTINGS)
"""All that a job may name."""


def make_effect(kind: str, settings: Mapping[str, Any]) -> Effect:
    """Restore an effect from its kind and what its `describe` returned.

    With a ``law`` it changes in time; the law's own settings go with it.

    Raises
    ------
    InputError
        If these are no settings of this kind.
    """
    law = settings.get("law", CONSTANT)
    if law == CONSTANT:
        constant: Effect = _make(EFFECTS[kind], _without(settings, ("law",)))
        return constant
    return _in_time(kind, str(law), settings)


def laws_of(kind: str) -> list[Effect]:
    """Return an effect that is to be looked for, with each of the laws by which it may go on in time."""
    from hydrabeam_mpi.effects.shared.in_time import LAWS

    sought = [law for law in EFFECTS[kind].laws if LAWS[law].sought]
    return [make_effect(kind, {"law": law}) for law in (CONSTANT, *sought)]


def _in_time(kind: str, law: str, settings: Mapping[str, Any]) -> Effect:
    from hydrabeam_mpi.effects.shared.in_time import LAWS, InTime

    known = (CONSTANT, *EFFECTS[kind].laws)
    if law not in known:
        raise InputError(f"no law '{law}' of this effect", field="settings", remedy=f"there are {', '.join(known)}")
    own = [field.name for field in fields(LAWS[law])]
    time_law = _make(LAWS[law], {name: settings[name] for name in own if name in settings})
    effect = _make(EFFECTS[kind], _without(settings, ("law", *own)))
    return effect.changing(time_law) or InTime(effect, time_law)


def _without(settings: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name not in names}


def make_cause(kind: str, settings: Mapping[str, Any]) -> Cause:
    """Do the same for an effect or one that is `SEPARATE`."""
    cause: Cause = make_effect(kind, settings) if kind in EFFECTS else _make(SEPARATE[kind], settings)
    return cause


def make_reweighting(kind: str, settings: Mapping[str, Any]) -> Reweighting:
    """Do the same for a change of the weights."""
    change: Reweighting = _make(REWEIGHTINGS[kind], settings)
    return change


def _make(of_kind: Any, settings: Mapping[str, Any]) -> Any:
    kinds = get_type_hints(of_kind if is_dataclass(of_kind) else of_kind.__init__, include_extras=True)
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
