"""All effects by the names that jobs give them; a new one has a file beside these and its line here."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter

from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_pointing import AntennaPointing
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.auto_coupling import AutoCoupling
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.effects.instrument.cable_reflections import CableReflections
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.instrument.leakage import Leakage
from hydrabeam_mpi.effects.instrument.mutual_coupling import MutualCoupling
from hydrabeam_mpi.effects.instrument.nonredundant_beams import NonredundantBeams
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.interface.effect import Cause, CrossPolarised, Effect
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.effects.noise.noise_level import NoiseLevel
from hydrabeam_mpi.effects.noise.outliers import Outliers
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.diffuse import Diffuse
from hydrabeam_mpi.effects.sky.horizon import Horizon
from hydrabeam_mpi.effects.sky.ionosphere import Ionosphere
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.errors import InputError

EFFECTS: Mapping[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        AntennaGains,
        AntennaDelays,
        CableReflections,
        CrossCoupling,
        AutoCoupling,
        MutualCoupling,
        MissingSources,
        CatalogueFlux,
        Diffuse,
        AntennaPositions,
        Timestamp,
        AntennaPointing,
        NonredundantBeams,
        BasisTruncation,
        Ionosphere,
        Horizon,
    )
}
"""Effects that change what the data are expected to be."""

REWEIGHTINGS: Mapping[str, type[Reweighting]] = {change.kind: change for change in (NoiseLevel, Outliers)}
"""Changes of how much the data weigh."""

SEPARATE: Mapping[str, type[CrossPolarised]] = {cause.kind: cause for cause in (Leakage,)}
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
