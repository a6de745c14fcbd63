"""Signals of one antenna in another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from astropy.constants import c as speed_of_light

from tests.validation.undeclared.answer import Drawn, Parameter, Where, baseline, pairs
from tests.validation.undeclared.setting import SPACING
from tests.validation.undeclared.truth import ComplexArray, Truth


def some_baselines(truth: Truth, rng: np.random.Generator, counts: Sequence[int] | None = None) -> list[int]:
    """Draw indices of baselines: one, six or all, or as many as one of ``counts``."""
    n = len(truth.setting.antpairs)
    return sorted(rng.choice(n, int(rng.choice(counts if counts is not None else [1, 6, n])), replace=False).tolist())


def cross_coupling(
    truth: Truth, rng: np.random.Generator, strength: float, counts: Sequence[int] | None = None
) -> Drawn:
    """Something that does not change with time is added to one, six or all baselines, ``strength`` Jy."""
    chosen = some_baselines(truth, rng, counts)
    values = strength * (rng.standard_normal(len(chosen)) + 1j * rng.standard_normal(len(chosen))) / np.sqrt(2)
    one, two = truth.setting.antpairs[chosen].T

    def corruption(vis: ComplexArray) -> ComplexArray:
        out = vis.copy()
        out[:, :, one, two] += values
        out[:, :, two, one] += values.conj()
        return out

    truth.corruptions.append(corruption)
    parameters = [
        Parameter(baseline(truth, bl), part, "Jy", float(number))
        for bl, value in zip(chosen, values, strict=True)
        for part, number in (("real", value.real), ("imaginary", value.imag))
    ]
    return Drawn(parameters, Where(antpairs=pairs(truth, chosen)), 2 * len(chosen))


def ground_emitter(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Something on the horizon is heard all the time, by ``strength`` Jy on every baseline."""
    azimuth = rng.uniform(0, 2 * np.pi)
    path = truth.setting.antpos @ np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    waves = truth.setting.freqs[:, np.newaxis] / speed_of_light.value * path
    voltages = np.sqrt(strength) * np.exp(-2j * np.pi * waves)[:, np.newaxis]
    truth.corruptions.append(lambda vis: vis + voltages[..., :, np.newaxis] * voltages[..., np.newaxis, :].conj())
    parameters = [
        Parameter("emitter", "azimuth", "deg", float(np.rad2deg(azimuth))),
        Parameter("emitter", "power", "Jy", strength),
    ]
    return Drawn(parameters, n_params=2)


def auto_coupling(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Part ``strength`` of one antenna's voltage comes out of the other's: V_jk += e_jk* V_jj + e_kj V_kk.

    e_jk is what of antenna j's voltage gets into antenna k. As all autocorrelations are equal, e_jk* + e_kj is told.
    """
    chosen = some_baselines(truth, rng)
    n = truth.setting.n_ants
    epsilon = np.zeros((n, n), dtype=complex)
    one, two = truth.setting.antpairs[chosen].T
    for first, second in ((one, two), (two, one)):
        draws = rng.standard_normal(len(chosen)) + 1j * rng.standard_normal(len(chosen))
        epsilon[first, second] = strength * draws / np.sqrt(2)

    def corruption(vis: ComplexArray) -> ComplexArray:
        autos = np.einsum("ftjj->ftj", vis)
        return vis + epsilon.conj() * autos[..., :, np.newaxis] + epsilon.T * autos[..., np.newaxis, :]

    truth.corruptions.append(corruption)
    sums = epsilon[one, two].conj() + epsilon[two, one]
    parameters = [
        Parameter(baseline(truth, bl), part, "", float(number))
        for bl, value in zip(chosen, sums, strict=True)
        for part, number in (("real", value.real), ("imaginary", value.imag))
    ]
    return Drawn(parameters, Where(antpairs=pairs(truth, chosen)), 2 * len(chosen))


def mutual_coupling(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Every element scatters part of what it receives to all others, once: V -> V + X V + V X^H.

    X_jk = Gamma (14.6 m / d_jk)^2 exp(2 pi i nu d_jk / c): a wave that is lost along the ground, and comes later.
    """
    gamma = strength * np.exp(1j * rng.uniform(-np.pi, np.pi))
    positions = truth.setting.antpos
    distance = np.linalg.norm(positions[:, np.newaxis] - positions, axis=-1)
    np.fill_diagonal(distance, np.inf)
    turns = truth.setting.freqs[:, np.newaxis, np.newaxis] * np.where(np.isinf(distance), 0, distance)
    spread = gamma * (SPACING / distance) ** 2 * np.exp(2j * np.pi * turns / speed_of_light.value)
    scattering = spread[:, np.newaxis]

    def corruption(vis: ComplexArray) -> ComplexArray:
        return vis + scattering @ vis + vis @ scattering.conj().swapaxes(-1, -2)

    truth.corruptions.append(corruption)
    parameters = [
        Parameter(f"coupling at {length * SPACING:.1f} m", part, "", float(value / length**2))
        for length in (1.0, np.sqrt(3), 2.0)
        for part, value in (("real", gamma.real), ("imaginary", gamma.imag))
    ]
    return Drawn(parameters, n_params=2)
