"""Noise that is not what its weights say."""

from __future__ import annotations

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, numbers, some_antennas
from tests.validation.undeclared.truth import ComplexArray, Truth


def noise_level(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The noise is larger by the factor 1 + ``strength``: of all data, or of one or three antennas."""
    n = truth.setting.n_ants
    factors = np.ones(n)
    chosen: list[int] = []
    if rng.random() < 0.5:
        chosen = some_antennas(truth, rng, (1, 3))
        factors[chosen] = (1 + strength) ** 2
        parameters = [Parameter(antenna(truth, i), "noise scale", "", float(factors[i])) for i in range(n)]
    else:
        factors[:] = 1 + strength
        parameters = [Parameter("array", "noise scale", "", 1 + strength)]
    one, two = truth.setting.antpairs.T
    scale = np.sqrt(factors[one] * factors[two])
    truth.noise.append(lambda noise, _: noise * scale)
    where = Where(antennas=numbers(truth, chosen)) if chosen else Where()
    return Drawn(parameters, where, max(len(chosen), 1))


def outliers(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Half a percent to three percent of the data are hit by bursts of a typical ``strength`` sigma."""
    fraction = float(np.exp(rng.uniform(np.log(0.005), np.log(0.03))))

    def bursts(noise: ComplexArray, draws: np.random.Generator) -> ComplexArray:
        hit = draws.random(noise.shape) < fraction
        phase = np.exp(2j * np.pi * draws.random(noise.shape))
        return noise + np.where(hit, strength * np.exp(draws.normal(0, 1, noise.shape)) * phase, 0)

    truth.noise.append(bursts)
    return Drawn(n_params=2, about={"fraction hit": fraction})
