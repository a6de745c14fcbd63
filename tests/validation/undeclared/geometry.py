"""Where the antennas stand, and when the data were taken."""

from __future__ import annotations

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, numbers, some_antennas
from tests.validation.undeclared.truth import Truth

DIRECTIONS = ("East", "North", "Up")


def antenna_positions(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One, three or all antennas stand off by ``strength`` metres in each direction."""
    chosen = some_antennas(truth, rng)
    offsets = np.zeros((truth.setting.n_ants, 3))
    offsets[chosen] = strength * rng.standard_normal((len(chosen), 3))
    truth.antpos = truth.antpos + offsets
    parameters = [
        Parameter(antenna(truth, index), f"displaced {direction}", "m", float(offset))
        for index in range(truth.setting.n_ants)
        for direction, offset in zip(DIRECTIONS, offsets[index], strict=True)
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 3 * len(chosen))


def smearing(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The data are means over ``strength`` seconds, in which the sky turns."""
    truth.integration = strength
    return Drawn([Parameter("integrations", "length", "s", strength)], n_params=1)


def timestamp(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The data were taken ``strength`` seconds later than they say, or earlier."""
    truth.clock = float(strength * rng.choice([-1, 1]))
    return Drawn([Parameter("clock", "later", "s", truth.clock)], n_params=1)
