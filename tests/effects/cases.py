"""Where and how strongly every effect of the catalogue is tried."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Cause, Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup


@dataclass(frozen=True)
class Case:
    """Where an effect is tried, and how strongly; what most effects can do with is the default.

    The columns are the derivative of the change at zero and, where that is ``exact``, at draws of these ``strengths``.
    ``step`` is that of numerical derivatives, over the parameters' scales. Errors of injected parameters are looked at
    with noise of ``noise`` times the largest change; without it what one channel tells of them is not enough.
    """

    settings: dict[str, Any] = field(default_factory=dict)
    freqs: tuple[float, ...] = (131e6, 151e6)
    n_times: int = 4
    nights: int = 1
    n_sources: int = 60
    channel: int = 0
    strengths: tuple[float, ...] = (1.0,)
    exact: Literal["anywhere", "where antennas are alike", "at zero"] = "anywhere"
    step: float = 1e-5
    noise: float | None = 0.01
    scan: tuple[float, float] = (1e-10, 1e-10)
    """Of what is scanned, by how much the sums of s* r and of |s|^2 may differ from those of the columns s."""


MAPS = (2e-3, 2e-3)  # in which the beam is interpolated
CASES = {
    "antenna_pointing": Case(strengths=(5.0, 100.0), exact="where antennas are alike", step=1e-2),
    "antenna_positions": Case(strengths=(1.0,), step=1e-4),
    "array_scale": Case(strengths=(1.0, 30.0), step=1e-2),  # up to three per cent
    "basis_truncation": Case({"n_before": 7}, step=1e-2),
    "cable_reflections": Case(freqs=tuple(140e6 + 1e6 * np.arange(6.0)), channel=1, strengths=(30.0,), noise=None),
    "catalogue_flux": Case(scan=MAPS),
    "diffuse": Case({"l_max": 3}),
    "horizon": Case(n_sources=1000, strengths=(0.3,), step=1e-2, scan=(1e-10, 0.2)),  # sources taken as orthogonal
    "ionosphere": Case(strengths=(3.0, 60.0), step=1e-2),  # up to a degree
    "missing_sources": Case(strengths=(20.0,), scan=MAPS),
    "moving_sources": Case(strengths=(20.0,), scan=MAPS),
    "mutual_coupling": Case({"n_shells": 2}),
    "nonredundant_beams": Case(strengths=(0.2,), exact="at zero", step=1e-3),
    "orientation": Case(strengths=(3.0, 60.0), step=1e-2),  # up to a degree
    "polarised_sources": Case(strengths=(1.0, 5.0), noise=None, scan=MAPS),
    # One channel tells flux from index by no more than products.
    "spectral_index": Case(strengths=(0.05, 2.0), scan=MAPS),
    "resolved_source": Case(strengths=(1.0, 400.0)),  # up to three degrees
    "elongated_source": Case(strengths=(1.0, 400.0)),
    "source_positions": Case(strengths=(1.0, 60.0), step=1e-2),  # up to a degree
    "saturation": Case(n_times=8),
    "smearing": Case(strengths=(1.0, 300.0), step=1e-2),
    "timestamp": Case(strengths=(1.0, 200.0), step=3e-3),
}
IN_TIME = {
    f"{kind}, {law}": replace(CASES.get(kind, Case()), settings={"law": law}, n_times=8, strengths=(0.3,))
    for kind, law in (
        ("antenna_gains", "smooth"),
        ("antenna_gains", "piecewise"),
        ("antenna_gains", "correlated"),
        ("antenna_delays", "smooth"),
        ("antenna_delays", "piecewise"),
        ("cross_coupling", "smooth"),
        ("catalogue_flux", "smooth"),
        ("catalogue_flux", "anew"),
        ("missing_sources", "smooth"),
        ("antenna_pointing", "smooth"),
        ("antenna_pointing", "piecewise"),
        ("timestamp", "smooth"),
        ("timestamp", "piecewise"),
        ("ionosphere", "smooth"),
    )
}
# Of a source that is low at a time next to nothing is seen, so that a small step is lost in rounding.
IN_TIME["catalogue_flux, anew"] = replace(IN_TIME["catalogue_flux, anew"], step=0.1)
IN_TIME |= {
    f"{kind}, {law}": replace(IN_TIME[f"{kind}, smooth"], settings={"law": law}, n_times=5, nights=2)
    for kind, law in (
        ("antenna_gains", "sidereal"),
        ("antenna_gains", "nightly"),
        ("cross_coupling", "sidereal"),
        ("cross_coupling", "nightly"),
        ("catalogue_flux", "nightly"),
        ("missing_sources", "nightly"),
        ("ionosphere", "nightly"),
    )
}
"""Effects with the laws by which they may change in time."""
VARIANTS = {f"ionosphere, {away}": Case({"away": away}, strengths=(3.0,), step=1e-2) for away in ("flat", "shell")}
VARIANTS |= {
    f"orientation, {fixed}": replace(CASES["orientation"], settings={"fixed": fixed}) for fixed in ("stars", "array")
}
VARIANTS |= {"array_scale, frequencies": replace(CASES["array_scale"], settings={"wrong": "frequencies"})}
VARIANTS |= {"polarised_sources, one channel": Case(freqs=(131e6,), strengths=(1.0, 5.0), scan=MAPS)}
"""Effects in other forms."""
CASES |= IN_TIME | VARIANTS


@cache
def experiment_of(freqs: tuple[float, ...], n_times: int, n_sources: int, nights: int = 1) -> ObservingSetup:
    return small_setup(freqs, n_times, n_sources, nights=nights)


def set_up(kind: str, n_sources: int | None = None) -> tuple[Effect, RowBlock, Case]:
    """Return an effect, with three candidates where it is scanned, and rows with residuals.

    Some rows are without weight, and so is all of one time.
    """
    case = CASES.get(kind, Case())
    block = small_block(experiment_of(case.freqs, case.n_times, n_sources or case.n_sources, case.nights), case.channel)
    rng = generator(11, "rows")
    residual = complex_normal(rng, block.shape)
    weights = rng.uniform(0.5, 2.0, block.shape) * (rng.uniform(size=block.shape) > 0.2)
    block = replace(block, residual=residual, weights=weights)
    block.weights[2] = 0.0
    effect = make_effect(kind.split(", ")[0], case.settings)
    if isinstance(effect, ScannedEffect):
        effect = effect.at(block.setup, candidates(effect, block))
    block.integrate_for([effect])
    return effect, block, case


def candidates(effect: ScannedEffect, block: RowBlock) -> IntArray:
    """Return three candidates that are far apart, of those that show well."""
    power = effect.scan(block)[1].sum(axis=1)
    seen = np.flatnonzero(power >= np.median(power[power > 0]))
    return seen[[len(seen) // 5, len(seen) // 2, -1 - len(seen) // 5]]


def draw(effect: Cause, setup: ObservingSetup, strength: float) -> FloatArray:
    return effect.draw(setup, generator(1, "contract", effect.kind), strength)


def places(effect: Effect, block: RowBlock, case: Case) -> list[FloatArray]:
    """Return parameters where the columns are the derivative of the exact change; in most one element is not off."""
    setup = block.setup
    parameters = effect.parameters(setup)
    some = [draw(effect, setup, strength) for strength in case.strengths]
    if case.exact == "where antennas are alike":
        some = [x @ np.linalg.pinv(held) @ held for x in some for held in [effect.degenerate_directions(setup)]]
    elif parameters.element.max() > 1:
        some = [np.where(parameters.element == 1, 0.0, x) for x in some]
    return [np.zeros(len(parameters)), *(some if case.exact != "at zero" else [])]
