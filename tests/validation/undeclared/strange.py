"""More of what no list of effects has: receivers, correlator, weather and sky as they are on a bad night.

Written by one who has not read how the package looks at what is left.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, numbers, pairs, some_antennas
from tests.validation.undeclared.beams import FloatArray, Shape
from tests.validation.undeclared.gains import multiplied
from tests.validation.undeclared.setting import altaz
from tests.validation.undeclared.truth import ComplexArray, Truth


def compression(truth: Truth, rng: np.random.Generator, strength: float, alike: bool = False) -> Drawn:
    """Amplifiers lose the part ``strength``, each its own, of their gain where the sky is twice as bright as always.

    That is what the job's beam would see on average. Where they are ``alike`` all lose the same.
    """
    n, setting = truth.setting.n_ants, truth.setting
    slopes = strength * (np.ones(n) if alike else rng.uniform(0.5, 1.5, n))
    usual = np.zeros(len(setting.freqs))
    for time in setting.times.tolist():
        za, az = altaz(setting.catalogue.ra, setting.catalogue.dec, time)
        for channel, freq in enumerate(setting.freqs.tolist()):
            seen = setting.model_shape.power(za, az, freq) * setting.catalogue.at(freq)
            usual[channel] += 0.5 * np.sum(seen[za < np.pi / 2]) / len(setting.times)

    def corruption(vis: ComplexArray) -> ComplexArray:
        power = np.einsum("ftjj->ftj", vis).real
        return multiplied(1 - slopes * (power / usual[:, np.newaxis, np.newaxis] - 1) + 0j)(vis)

    truth.corruptions.append(corruption)
    per_kjy = slopes * float(np.mean(1e3 / usual))
    parameters = [
        Parameter(antenna(truth, index), "compression", "1/kJy", value) for index, value in enumerate(per_kjy.tolist())
    ]
    return Drawn(parameters, n_params=1 if alike else n)


def saturating_receivers(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Receivers of one or three antennas lose the part ``strength`` of their gain at the largest power, less below it.

    The loss goes with the cube of the power, of which a half is their own noise, on average.
    """
    some = some_antennas(truth, rng, (1, 3))

    def corruption(vis: ComplexArray) -> ComplexArray:
        sky = np.einsum("ftjj->ftj", vis).real
        power = sky + sky.mean(axis=1, keepdims=True)
        gains = np.ones(power.shape)
        gains[..., some] -= strength * (power / power.max(axis=1, keepdims=True))[..., some] ** 3
        return multiplied(gains + 0j)(vis)

    truth.corruptions.append(corruption)
    return Drawn(n_params=3 * len(some))


def ambient_temperature(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Gains follow the temperature of the night, amplitudes falling by about ``strength`` and phases as the cables are.

    The night gets colder until a warm front comes.
    """
    seconds, n_ants = truth.setting.seconds, truth.setting.n_ants
    front = rng.uniform(0.4, 0.7) * seconds[-1]
    temperature = np.exp(-seconds / 9e3) + np.where(seconds > front, 1 - np.exp(-(seconds - front) / 3e3), 0)
    temperature = (temperature - temperature.mean()) / np.ptp(temperature)
    slopes = -strength * rng.uniform(0.5, 1.5, n_ants) + 1j * strength * rng.standard_normal(n_ants)
    truth.corruptions.append(multiplied(np.exp(temperature[np.newaxis, :, np.newaxis] * slopes)))
    return Drawn(n_params=2 * n_ants)


def turning_antenna(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One element is loose: its beam, longer one way by the part ``strength``, makes half a turn during the night."""
    index, n_times = int(rng.integers(truth.setting.n_ants)), len(truth.setting.times)
    start = rng.uniform(0, np.pi)

    def shape(channel: int, time: int, beam: Shape) -> Shape:
        angle = 2 * (start + np.pi * time / n_times)

        def stretched(l: FloatArray, m: FloatArray) -> FloatArray:
            r2 = l**2 + m**2
            along = (l**2 - m**2) * np.cos(angle) + 2 * l * m * np.sin(angle)
            return np.asarray(strength * along / (r2 + 0.22**2))

        return replace(beam, extra=stretched)

    truth.shape_of_antenna[index] = shape
    return Drawn(where=Where(antennas=numbers(truth, [index])), n_params=3)


def jitter(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Sampling clocks tremble against each other, the more the farther apart: the longest baselines lose ``strength``.

    As turbulence has it, exp(-s (b/b_max)^(5/3)), and s comes and goes in waves.
    """
    lengths = np.linalg.norm(truth.setting.antpos[:, np.newaxis] - truth.setting.antpos, axis=-1)
    phase, turns = rng.uniform(0, 2 * np.pi), rng.uniform(1, 3)
    waves = 1 + np.sin(phase + 2 * np.pi * turns * truth.setting.seconds / truth.setting.seconds[-1])
    loss = strength * waves[:, np.newaxis, np.newaxis] * (lengths / lengths.max()) ** (5 / 3)
    truth.corruptions.append(lambda vis: vis * np.exp(-loss))
    return Drawn(n_params=3)


def of_one_board(truth: Truth, rng: np.random.Generator) -> tuple[list[int], NDArray[np.bool_]]:
    """Draw the baselines that one of eight boards of the correlator computes, and say so of all pairs of antennas."""
    n = len(truth.setting.antpairs)
    board = sorted(rng.permutation(n)[: max(n // 8, 1)].tolist())
    of_pair = np.zeros((truth.setting.n_ants, truth.setting.n_ants), dtype=bool)
    of_pair[tuple(truth.setting.antpairs[board].T)] = True
    return board, of_pair


def board_stops_wrong_fringes(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """From midnight on the phases of one board's baselines run away, by ``strength`` turns until the end."""
    board, of_pair = of_one_board(truth, rng)
    late = np.clip(truth.setting.seconds / truth.setting.seconds[-1] - 0.5, 0, None) * 2
    phases = 2 * np.pi * strength * late[:, np.newaxis, np.newaxis] * (of_pair * 1.0 - of_pair.T)
    truth.corruptions.append(lambda vis: vis * np.exp(1j * phases))
    return Drawn(where=Where(antpairs=pairs(truth, board)), n_params=2)


def board_drops_packets(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One board's baselines lose up to the part ``strength`` of every integration, each time another."""
    board, of_pair = of_one_board(truth, rng)
    lost = strength * rng.random(len(truth.setting.times)) ** 2
    truth.corruptions.append(lambda vis: vis * (1 - lost[:, np.newaxis, np.newaxis] * (of_pair | of_pair.T)))
    return Drawn(where=Where(antpairs=pairs(truth, board)), n_params=2)


def cables_swapped(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Somebody plugs two antennas into each other's receivers and corrects it a third of the night later."""
    two, n_times = sorted(rng.choice(truth.setting.n_ants, 2, replace=False).tolist()), len(truth.setting.times)
    first = int(rng.integers(1, n_times - n_times // 3))
    order = np.arange(truth.setting.n_ants)
    order[two] = order[two[::-1]]

    def corruption(vis: ComplexArray) -> ComplexArray:
        vis = vis.copy()
        during = slice(first, first + n_times // 3)
        vis[:, during] = vis[:, during][:, :, order][..., order]
        return vis

    truth.corruptions.append(corruption)
    return Drawn(where=Where(antennas=numbers(truth, two)), n_params=4)


def wandering_oscillator(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """A tone of ``strength`` Jy leaks into three antennas; its frequency drifts, so that its fringes slow down."""
    three = sorted(rng.choice(truth.setting.n_ants, 3, replace=False).tolist())
    phases = np.zeros((truth.setting.n_ants, 1))
    phases[three, 0] = rng.uniform(0, 2 * np.pi, 3)
    part = truth.setting.seconds / truth.setting.seconds[-1]
    turns = (rng.uniform(1, 4) * part + rng.uniform(1, 3) * part**2)[:, np.newaxis, np.newaxis]
    # Each hears it with a delay of its own, which the drift turns into a phase of its own.
    order = np.zeros(truth.setting.n_ants)
    order[three] = rng.permutation(3)
    hears = np.isin(np.arange(truth.setting.n_ants), three)
    both = np.triu(np.outer(hears, hears), 1)
    difference = order[:, np.newaxis] - order
    tone = strength * both * np.exp(2j * np.pi * turns * difference + 1j * (phases - phases.T))
    truth.corruptions.append(lambda vis: vis + tone + tone.conj().swapaxes(-1, -2))
    chosen = [bl for bl, pair in enumerate(truth.setting.antpairs.tolist()) if set(pair) <= set(three)]
    return Drawn(where=Where(antpairs=pairs(truth, chosen)), n_params=4)


def water_vapour(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """A lens of vapour hangs over the array, ``strength`` radians from its middle to its edge, anew at each time."""
    offsets = truth.setting.antpos[:, :2] - truth.setting.antpos[:, :2].mean(axis=0)
    bulge = np.sum(offsets**2, axis=1) / np.sum(offsets**2, axis=1).max()
    depth = strength * rng.standard_normal(len(truth.setting.times))
    truth.corruptions.append(multiplied(np.exp(1j * depth[np.newaxis, :, np.newaxis] * bulge)))
    return Drawn(n_params=len(depth))
