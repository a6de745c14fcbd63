"""What it costs that the evidence chooses a prior: the nats by which its maximum overrates an effect."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Parameters

COUNTS = 1.5
"""N(> S) falls as S to minus this: sources that are alike and spread evenly over Euclidean space.

dN/dS falls with one power more, S^-5/2. Radio sources at 150 MHz follow both where they are bright, above a Jansky, as
those that are rare beside a catalogue are; fainter counts are flatter, and there nothing is rare.
"""


def price_of(parameters: Parameters, prior_var: FloatArray) -> float:
    """Return the nats that it costs that the evidence chose the widths of a prior and its elements.

    ``prior_var`` is (q,), zero for parameters that are left out.
    """
    can = (parameters.scale > 0) & ~parameters.nonlinear
    n_taken = len(np.unique(parameters.element[prior_var > 0]))
    if n_taken == 0:
        return 0.0
    if parameters.sort is not None and len(gone := np.setdiff1d(parameters.sort[can], parameters.sort[prior_var > 0])):
        return price_of_sorts(parameters) + price_of(without_sorts(parameters, gone), prior_var)
    widths = np.sqrt(prior_var[can]) / parameters.scale[can]
    widest = np.zeros(int(parameters.element.max()) + 1)
    np.maximum.at(widest, parameters.element[can], widths)
    rare = float(np.sum(rarity(parameters, widest)))
    if np.allclose(widths, widths[0]) and len(np.unique(parameters.element)) >= parameters.trials:
        return 1.0 + rare
    if parameters.across is not None and _is_of_sets(parameters.across[can], widths):
        return price_of(sets_of(parameters), prior_var)
    return rare + float(sum(1 + np.log(max(parameters.trials - n, 1)) - np.log(n + 1) for n in range(n_taken)))


def price_of_sorts(parameters: Parameters) -> float:
    """Return what it costs that some sorts of parameters are left out: ln of the number of ways to do so."""
    assert parameters.sort is not None
    n = len(np.unique(parameters.sort[(parameters.scale > 0) & ~parameters.nonlinear]))
    return float(np.log(max(2.0**n - 2, 1.0)))


def without_sorts(parameters: Parameters, gone: IntArray) -> Parameters:
    """Return the parameters with those of some sorts held at zero."""
    assert parameters.sort is not None
    scale = np.where(np.isin(parameters.sort, gone), 0.0, parameters.scale)
    several = len(np.unique(parameters.sort[scale > 0])) > 1
    return replace(parameters, scale=scale, sort=parameters.sort if several else None)


def rarity(parameters: Parameters, widths: FloatArray | float) -> Any:
    """Return the nats that an element of these widths costs because fewer than one of its size is expected.

    That is ln 1 / N(> S): what has to be explained is that there is one as bright or brighter at all, which is why the
    slope is that of N and not of dN/dS; how its flux is spread below its width is the prior's own matter. A source 50
    times as bright as the brightest that is expected costs 1.5 ln 50 = 6 nats: of 350 skies one has it.
    """
    return COUNTS * np.log(np.maximum(np.asarray(widths) / parameters.rare_above, 1.0))


def _is_of_sets(sets: IntArray, widths: FloatArray) -> bool:
    """Whether all parameters of a set have the same width, which for some is zero."""
    return all(np.allclose(widths[sets == one], widths[sets == one][0]) for one in np.unique(sets))


def sets_of(parameters: Parameters) -> Parameters:
    """Return the parameters with their sets across all elements as the elements."""
    assert parameters.across is not None
    return replace(parameters, element=parameters.across, trials=parameters.across_trials, nested=False, across=None)
