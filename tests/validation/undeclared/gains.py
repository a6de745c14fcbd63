"""Gains of antennas: V_jk -> g_j g_k* V_jk.

A delay tau multiplies the voltage with exp(+2 pi i nu tau), as the phase of a visibility grows with b.s nu/c, and the
wave reaches the second antenna b.s/c before the first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, numbers, some_antennas
from tests.validation.undeclared.truth import ComplexArray, Corruption, Truth


def multiplied(gains: ComplexArray) -> Corruption:
    """Return the corruption by gains, (Nfreqs or 1, Ntimes or 1, Nants)."""

    def corruption(vis: ComplexArray) -> ComplexArray:
        return gains[..., :, np.newaxis] * gains[..., np.newaxis, :].conj() * vis

    return corruption


def antenna_gains(
    truth: Truth, rng: np.random.Generator, strength: float, counts: Sequence[int] | None = None
) -> Drawn:
    """Amplitudes and phases of one, three or all antennas are off by ``strength``, the same in every channel."""
    chosen = some_antennas(truth, rng, counts)
    logs = np.zeros(truth.setting.n_ants, dtype=complex)
    logs[chosen] = strength * (rng.standard_normal(len(chosen)) + 1j * rng.standard_normal(len(chosen)))
    truth.corruptions.append(multiplied(np.exp(logs)[np.newaxis, np.newaxis]))
    parameters = [
        parameter
        for index in range(truth.setting.n_ants)
        for parameter in (
            Parameter(antenna(truth, index), "ln amplitude", "", float(logs[index].real)),
            Parameter(antenna(truth, index), "phase", "rad", float(logs[index].imag)),
        )
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 2 * len(chosen))


def antenna_delays(
    truth: Truth, rng: np.random.Generator, strength: float, counts: Sequence[int] | None = None, centred: bool = False
) -> Drawn:
    """Signals of one, three or all antennas come late by ``strength`` ns, or early.

    Where that is ``centred``, somebody has set the phases right at the band's centre. Phases are told there.
    """
    chosen = some_antennas(truth, rng, counts)
    delays = np.zeros(truth.setting.n_ants)
    delays[chosen] = strength * 1e-9 * rng.standard_normal(len(chosen))
    middle = float(truth.setting.freqs.mean())
    phases = np.zeros(len(delays)) if centred else 2 * np.pi * middle * delays
    turns = (truth.setting.freqs - middle)[:, np.newaxis, np.newaxis] * delays
    truth.corruptions.append(multiplied(np.exp(2j * np.pi * turns + 1j * phases)))
    parameters = [
        parameter
        for index in range(truth.setting.n_ants)
        for parameter in (
            Parameter(antenna(truth, index), "delay", "ns", float(1e9 * delays[index])),
            Parameter(antenna(truth, index), "phase", "rad", float(phases[index])),
        )
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 2 * len(chosen))


def cable_reflections(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Part ``strength`` of the voltage of one or two antennas comes again 80 to 200 ns later.

    The phase of the amplitude is that at the mean frequency.
    """
    chosen = some_antennas(truth, rng, (1, 2))
    gains = np.ones((len(truth.setting.freqs), 1, truth.setting.n_ants), dtype=complex)
    offset = truth.setting.freqs - truth.setting.freqs.mean()
    parameters = []
    for index in chosen:
        delay, amplitude = rng.uniform(80e-9, 200e-9), strength * np.exp(1j * rng.uniform(-np.pi, np.pi))
        gains[:, 0, index] += amplitude * np.exp(2j * np.pi * offset * delay)
        who = antenna(truth, index)
        parameters += [
            Parameter(who, "reflection real", "", float(amplitude.real)),
            Parameter(who, "reflection imaginary", "", float(amplitude.imag)),
            Parameter(who, "reflection delay", "ns", 1e9 * delay),
        ]
    truth.corruptions.append(multiplied(gains))
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 3 * len(chosen))
