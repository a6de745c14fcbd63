"""What effects there are, and what is to be known of each: equations, signs, units, settings and parameters."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from hydrabeam_mpi.config.simulation import Array, Simulate
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import EFFECTS, KINDS, REWEIGHTINGS, SEPARATE, make_cause, make_reweighting
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.beam import analytic_beam
from hydrabeam_mpi.model.fit import fit_beam
from hydrabeam_mpi.model.sky import mock_sky
from hydrabeam_mpi.simulation.mock import mock_observation
from hydrabeam_mpi.words import did_you_mean


def list_effects() -> str:
    """Return a line on each effect: its name in job files, and its title."""
    classes: list[tuple[str, Any]] = [(kind, _class_of(kind)) for kind in KINDS]
    width = max(map(len, KINDS))
    return "\n".join(f"{kind:{width}}  {one.title}" for kind, one in classes)


def words_of(kind: str) -> str:
    """Return what an effect's own words say of it, as a section in Markdown.

    Raises
    ------
    InputError
        If there is no such effect.
    """
    if kind not in KINDS:
        remedy = f"{did_you_mean(kind, KINDS)}'hydrabeam effects' lists them"
        raise InputError(f"no effect '{kind}'", field="effects", remedy=remedy)
    effect = _class_of(kind)
    about = inspect.cleandoc(sys.modules[effect.__module__].__doc__ or "")
    more, *settings = re.split(r"\n(?:Parameters|Attributes)\n-+\n", f"{inspect.getdoc(effect)}")
    entries = re.findall(r"^([\w, ]+?)(?: : (.*))?\n((?:    .*\n?)+)", "".join(settings), re.MULTILINE)
    listed = [
        f"- `{name}`{f' ({type_})' if type_ else ''}: {' '.join(words.split())}" for name, type_, words in entries
    ]
    names = f"Parameters such as {', '.join(_parameters(kind))}."
    return "\n".join([f"## `{kind}`\n", f"{about}\n", f"{more.strip()}\n", *listed, f"\n{names}\n"])


def print_effects(kind: str | None) -> None:
    """Print the list, or what is to be known of one."""
    print(list_effects() if kind is None else words_of(kind).strip())


def _class_of(kind: str) -> Any:
    classes: tuple[Mapping[str, Any], ...] = (EFFECTS, SEPARATE, REWEIGHTINGS)
    return next(kinds[kind] for kinds in classes if kind in kinds)


def _parameters(kind: str) -> list[str]:
    """Return names of an effect's parameters with units: one of each sort, by what is not a number in them."""
    setup = _observed()
    if kind in REWEIGHTINGS:
        pairs = [(name, "") for name in make_reweighting(kind, {}).neutral(setup)]
    else:
        cause = make_cause(kind, {})
        if not len(cause.parameters(setup)):
            cause = cause.drawn(setup, np.random.default_rng(1))
        parameters = cause.parameters(setup)
        pairs = list(zip(parameters.names, parameters.units, strict=True))
    sorts: dict[str, str] = {}
    for name, unit in pairs:
        sorts.setdefault(re.sub(r"-?\d[\d.]*", "#", name), f"`{name}`{f' ({unit})' if unit else ''}")
    return list(sorts.values())


@cache
def _observed() -> ObservingSetup:
    """Return what a hexagon of seven antennas with an Airy beam observes: enough for parameters to have their names."""
    freqs = tuple(140e6 + 1e6 * np.arange(6.0))
    observation = mock_observation(Simulate(array=Array(hex=(2, 3)), n_times=8, freqs=freqs), "ee")
    spec = FourierBessel.selection(n_modes=None, form="real", k_max=8, m_max=1, edge=np.deg2rad(92), boundary="neumann")
    fit = fit_beam(analytic_beam("airy", freqs[0], "ee", diameter=14.0), spec)
    return ObservingSetup(
        observation=observation,
        redundant=find_redundant_groups(observation.bl_vectors, 1e-7),
        sky=mock_sky(3, observation.freqs, n_sources=60),
        basis=fit.basis,
        prior_mean=(fit.coeffs,) * len(freqs),
        file_pols=("ee", "nn", "en", "ne"),
        times=np.arange(observation.Ntimes),
    )
