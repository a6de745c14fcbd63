"""Data that should not be fitted before they are mended or left out."""

from __future__ import annotations

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, numbers, some_antennas
from tests.validation.undeclared.setting import FloatArray
from tests.validation.undeclared.truth import ComplexArray, Truth


def wrong_scale(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """All data are too small by the factor ``strength``, or too large: nobody has brought them to Jy."""
    scale = float(strength ** rng.choice([-1, 1]))
    truth.filed.append(lambda data: scale * data)
    truth.filed_autos.append(lambda autos: scale * autos)
    return Drawn([Parameter("array", "scale", "", scale)], n_params=1)


def dead_antennas(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One or two antennas give nothing, or next to nothing, and nobody has flagged them."""
    chosen = some_antennas(truth, rng, (1, 2))
    remains = float(rng.choice([0.0, 1e-6]))
    hit = np.isin(truth.setting.antpairs, chosen).sum(axis=1)

    def autos(values: FloatArray) -> FloatArray:
        values = values.copy()
        values[..., chosen] *= remains
        return values

    truth.filed.append(lambda data: data * np.sqrt(remains) ** hit)
    truth.filed_autos.append(autos)
    return Drawn(where=Where(antennas=numbers(truth, chosen)), n_params=len(chosen), about={"what remains": remains})


def bad_integrations(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One to three integrations, fitted or held out, hold something else on all baselines.

    They are hit by lightning of ``strength`` sigma, repeat the one before, or have lost most of their packets.
    """
    n_times = len(truth.setting.times)
    chosen = np.sort(rng.choice(np.arange(1, n_times), int(rng.integers(1, 4)), replace=False))
    sort = int(rng.integers(3))

    def burst(noise: ComplexArray, draws: np.random.Generator) -> ComplexArray:
        noise = noise.copy()
        more = draws.standard_normal((2, *noise[:, chosen].shape))
        noise[:, chosen] += strength * (more[0] + 1j * more[1]) / np.sqrt(2)
        return noise

    def repeated(data: ComplexArray) -> ComplexArray:
        data = data.copy()
        for time in chosen.tolist():
            data[:, time] = data[:, time - 1]
        return data

    def lost(data: ComplexArray) -> ComplexArray:
        data = data.copy()
        data[:, chosen] *= 0.3
        return data

    if sort == 0:
        truth.noise.append(burst)
    else:
        truth.filed.append(repeated if sort == 1 else lost)
    return Drawn(where=Where(times=chosen.tolist()), n_params=len(chosen), about={"sort": float(sort)})
