"""What is stored of every draw: the variables of a walk, and their values where a chain is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hydrabeam_mpi.config.sample import BEAM, NOISE, PRIOR_WIDTH
from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.fit.grown import added_coefficients
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.mpi import bcast_object, gather_by_channel
from hydrabeam_mpi.sampling.state import ChainState
from hydrabeam_mpi.sampling.storage.variable import Variable
from hydrabeam_mpi.sampling.walk import Walk

EFFECT_WIDTH = "effect_width"
"""Name of the variable of widths of effects' priors."""
PACE = "pace"
"""Name of step and scale of the proposals among the arrays of a state."""


def variables_of(walk: Walk) -> tuple[Variable, ...]:
    """Return what is stored of every draw of a walk.

    Parameters that channels share are stored once; all else has an axis of channels.
    """
    setup, basis = walk.context.setup, walk.context.problem.basis
    freqs = setup.observation.freqs.tolist()
    n_freqs, n_groups = len(freqs), int(walk.group_of.max(initial=-1)) + 1
    found = [
        Variable(
            BEAM,
            BEAM,
            (n_freqs, basis.n_modes),
            ("freq", "mode"),
            {"freq": freqs},
            long_name="coefficients of the beam; freq in Hz",
            dtype="complex128" if basis.is_complex else "float64",
        )
    ]
    names = _names(walk)
    for name, one in zip(names, walk.unknowns.active, strict=True):
        told = one.labels(setup)
        shared, dim = one.prior.shared, f"{name}_parameter"
        units = {unit for _, unit in told}
        labels = [label if len(units) == 1 or not unit else f"{label} ({unit})" for label, unit in told]
        found.append(
            Variable(
                name,
                one.kind,
                (one.size,) if shared else (n_freqs, one.size),
                (dim,) if shared else ("freq", dim),
                {dim: labels} if shared else {"freq": freqs, dim: labels},
                units.pop() if len(units) == 1 else "",
                one.effect.title,
            )
        )
    if walk.noise is not None:
        found.append(_of_noise(walk, freqs))
    if walk.widths is not None:
        what = "variances of the beam's prior over the stated ones"
        dims, coords = ("freq", "group"), {"freq": freqs}
        found.append(Variable(PRIOR_WIDTH, PRIOR_WIDTH, (n_freqs, n_groups), dims, coords, long_name=what))
    if walk.spreads is not None:
        of = walk.unknowns.width_of
        names = [
            names[place] for place, span in enumerate(walk.unknowns.spans) for _ in np.unique(of[span][of[span] >= 0])
        ]
        labels = [f"{name} {names[:number].count(name)}" for number, name in enumerate(names)]
        what = "variances of effects' priors over the stated ones, channel by channel and thing by thing"
        found.append(Variable(EFFECT_WIDTH, EFFECT_WIDTH, (len(labels),), ("of",), {"of": labels}, long_name=what))
    return tuple(found)


def arrays_of(walk: Walk, state: ChainState) -> dict[str, Array]:
    """Return a state as the values of the variables, and the ``pace`` of its proposals, on rank 0.

    Nothing on other ranks. Collective: the chain's ranks.
    """
    grid = walk.context.grid
    noise = state.noise if walk.parts is None else state.parts
    mine = list(zip(state.beams, noise, state.widths, strict=True)) if grid.is_group_root else []
    gathered = gather_by_channel(grid, mine)
    if not gathered:
        return {}
    beams, noise, widths = map(np.array, zip(*gathered, strict=True))
    vector = walk.unknowns.vector(state.values)
    arrays = {BEAM: beams + _in_common(walk, state.values), PACE: np.array([state.step, state.scale])}
    for name, one, span in zip(_names(walk), walk.unknowns.active, walk.unknowns.spans, strict=True):
        arrays[name] = vector[span] if one.prior.shared else vector[span].reshape(-1, one.size)
    arrays |= {NOISE: noise} if walk.noise is not None else {}
    arrays |= {EFFECT_WIDTH: state.spreads} if walk.spreads is not None else {}
    return arrays | ({PRIOR_WIDTH: widths} if walk.widths is not None else {})


def _in_common(walk: Walk, values: Values) -> Array:
    """Return what effects add to the coefficients of the beams of all channels, which are kept as a whole.

    The result is (Nfreqs, n_modes).
    """
    setup = walk.context.setup
    return np.array([added_coefficients(setup, values, channel) for channel in range(setup.observation.Nfreqs)])


def state_from(walk: Walk, arrays: Mapping[str, Array] | None) -> ChainState:
    """Return the state that `arrays_of` gave on rank 0, where ``arrays`` are. Collective: the chain's ranks."""
    told: Any = bcast_object(walk.context.grid.world, None if arrays is None else dict(arrays))
    channels = walk.channels
    parts = [told[name].reshape(-1) for name in _names(walk)]
    n_local = len(channels)
    noise, widths, of_parts = np.ones(n_local), np.ones((n_local, 0)), np.ones((n_local, 0))
    if walk.parts is not None:
        of_parts = told[NOISE][channels]
    elif walk.noise is not None:
        noise = told[NOISE][channels]
    if walk.widths is not None:
        widths = told[PRIOR_WIDTH][channels]
    vector, spreads = np.concatenate([np.zeros(0), *parts]), told.get(EFFECT_WIDTH, np.ones(0))
    values = walk.unknowns.at(vector)
    beams = tuple((told[BEAM] - _in_common(walk, values))[channels])
    return ChainState(values, beams, noise, widths, of_parts, told[PACE][0], told[PACE][1], spreads)


def _of_noise(walk: Walk, freqs: list[float]) -> Variable:
    what, parts = "variance of the noise over the stated one", walk.parts
    if parts is None:
        return Variable(NOISE, NOISE, (len(freqs),), ("freq",), {"freq": freqs}, long_name=what)
    what += {"antenna": ", of each antenna: its two multiply", "length": ", of baselines of each length in m"}[
        parts.name
    ]
    coords = {"freq": freqs, parts.name: list(parts.labels)}
    return Variable(NOISE, NOISE, (len(freqs), len(parts.labels)), ("freq", parts.name), coords, long_name=what)


def _names(walk: Walk) -> list[str]:
    """Return a name for each effect that moves: its kind, numbered where there are several."""
    active: list[Active] = walk.unknowns.active
    kinds = [one.kind for one in active]
    numbers = [kinds[: place + 1].count(kind) for place, kind in enumerate(kinds)]
    return [f"{kind}_{number}" if number > 1 else kind for kind, number in zip(kinds, numbers, strict=True)]
