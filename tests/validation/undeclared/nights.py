"""What is alike every night by sidereal time, or begins anew: gains and coupling in data of several nights."""

from __future__ import annotations

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, baseline, numbers, pairs, some_antennas
from tests.validation.undeclared.beams import FloatArray
from tests.validation.undeclared.gains import multiplied
from tests.validation.undeclared.in_time import CURVATURE, DRIFT
from tests.validation.undeclared.truth import ComplexArray, Truth

FEW = (1, 3)


def functions_of(truth: Truth) -> dict[str, FloatArray]:
    """Return the law's functions by what their numbers are called, of sidereal time and of each night, (Ntimes,)."""
    days = truth.setting.times - truth.setting.times[0]
    night = np.round(days).astype(int)
    since = days - np.array([days[night == n].min() for n in night])
    clock = since / since.max() - 0.5
    functions = {DRIFT: clock, CURVATURE: 4 * clock**2}
    for n in np.unique(night).tolist():
        functions[f"night {n + 1}: level"] = 1.0 * (night == n)
        functions[f"night {n + 1}: {DRIFT}"] = np.where(night == n, clock, 0.0)
    return functions


def changing_gains(truth: Truth, rng: np.random.Generator, strength: float, *called: str) -> Drawn:
    """Gains of one or three antennas change by ``strength`` with each of the functions that are called so."""
    functions = functions_of(truth)
    chosen, names = some_antennas(truth, rng, FEW), _anew(functions) if not called else list(called)
    sizes = np.zeros((len(names), truth.setting.n_ants), dtype=complex)
    shape = (len(names), len(chosen))
    sizes[:, chosen] = strength * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    logs = np.stack([functions[name] for name in names], axis=1) @ sizes
    truth.corruptions.append(multiplied(np.exp(logs)[np.newaxis]))
    parameters = [
        Parameter(antenna(truth, index), f"{what}, {name}", unit, float(value))
        for index in range(truth.setting.n_ants)
        for name, size in zip(names, sizes[:, index], strict=True)
        for what, unit, value in (("ln amplitude", "", size.real), ("phase", "rad", size.imag))
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 2 * sizes[:, chosen].size)


def sidereal_gains(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Gains of one or three antennas drift and bend, in the same way every night."""
    return changing_gains(truth, rng, strength, DRIFT, CURVATURE)


def nightly_gains(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Gains of one or three antennas are others each night, and drift anew."""
    return changing_gains(truth, rng, strength)


def levels_of_nights(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Gains of one or three antennas are others each night, and stay so until it ends."""
    return changing_gains(truth, rng, strength, *[name for name in _anew(functions_of(truth)) if "level" in name])


def nightly_coupling(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """What leaks into one or two baselines is another each night, by ``strength`` Jy, and drifts anew."""
    functions = functions_of(truth)
    names, n = _anew(functions), len(truth.setting.antpairs)
    chosen = sorted(rng.choice(n, int(rng.integers(1, 3)), replace=False).tolist())
    sizes = strength * np.exp(2j * np.pi * rng.random((len(names), len(chosen))))
    one, two = truth.setting.antpairs[chosen].T
    now = np.stack([functions[name] for name in names], axis=1) @ sizes

    def corruption(vis: ComplexArray) -> ComplexArray:
        out = vis.copy()
        out[:, :, one, two] += now
        out[:, :, two, one] += now.conj()
        return out

    truth.corruptions.append(corruption)
    parameters = [
        Parameter(baseline(truth, bl), f"{part}, {name}", "Jy", float(number))
        for bl, of_baseline in zip(chosen, sizes.T, strict=True)
        for name, value in zip(names, of_baseline, strict=True)
        for part, number in (("real", value.real), ("imaginary", value.imag))
    ]
    return Drawn(parameters, Where(antpairs=pairs(truth, chosen)), 2 * sizes.size)


def _anew(functions: dict[str, FloatArray]) -> list[str]:
    """Return the functions of single nights, whose levels are those above the first night's."""
    return [name for name in functions if name.startswith("night") and name != "night 1: level"]
