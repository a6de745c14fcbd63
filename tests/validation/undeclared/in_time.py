"""What changes during the night: gains, delays, coupling, pointing and clocks that drift, jump or jitter; fading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, baseline, numbers, pairs, some_antennas
from tests.validation.undeclared.beams import REFERENCE_FREQ, FloatArray, Shape
from tests.validation.undeclared.gains import multiplied
from tests.validation.undeclared.setting import Catalogue, altaz
from tests.validation.undeclared.skies import missing_source
from tests.validation.undeclared.truth import ComplexArray, Truth

DRIFT = "drift from first to last time"
CURVATURE = "curvature, ends less middle"


def clock_of(truth: Truth) -> FloatArray:
    """Return the time from -1/2 at the first integration to 1/2 at the last."""
    return truth.setting.seconds / truth.setting.seconds[-1] - 0.5


def drifting_gains(
    truth: Truth, rng: np.random.Generator, strength: float, counts: Sequence[int] | None = None
) -> Drawn:
    """Gains of one, three or all antennas drift by ``strength`` over the night, and bend half as much."""
    clock, n_ants = clock_of(truth), truth.setting.n_ants
    chosen = some_antennas(truth, rng, counts)
    drift, bend = np.zeros(n_ants, dtype=complex), np.zeros(n_ants, dtype=complex)
    for of_all, size in ((drift, strength), (bend, strength / 2)):
        of_all[chosen] = size * (rng.standard_normal(len(chosen)) + 1j * rng.standard_normal(len(chosen)))
    logs = np.outer(clock, drift) + np.outer(4 * clock**2 - 1 / 3, bend)
    truth.corruptions.append(multiplied(np.exp(logs)[np.newaxis]))
    parameters = [
        Parameter(antenna(truth, index), f"{what}, {how}", unit, float(value))
        for index in range(n_ants)
        for how, change in ((DRIFT, drift[index]), (CURVATURE, bend[index]))
        for what, unit, value in (("ln amplitude", "", change.real), ("phase", "rad", change.imag))
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 4 * len(chosen))


def drifting_delays(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The cables of one or three antennas get longer, or shorter, by ``strength`` ns over the night."""
    chosen, freqs = some_antennas(truth, rng, (1, 3)), truth.setting.freqs
    drift = np.zeros(truth.setting.n_ants)
    drift[chosen] = strength * rng.standard_normal(len(chosen))
    turns = 1e-9 * freqs[:, np.newaxis, np.newaxis] * np.outer(clock_of(truth), drift)
    truth.corruptions.append(multiplied(np.exp(2j * np.pi * turns)))
    parameters = [
        Parameter(antenna(truth, index), f"{what}, {DRIFT}", unit, float(value))
        for index in range(truth.setting.n_ants)
        for what, unit, value in (
            ("delay", "ns", drift[index]),
            ("phase", "rad", 2e-9 * np.pi * freqs.mean() * drift[index]),
        )
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 2 * len(chosen))


def gain_jitter(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The gains of one or three antennas, or their phases alone, differ by ``strength`` at each integration."""
    chosen, n_times = some_antennas(truth, rng, (1, 3)), len(truth.setting.times)
    size = strength * np.array([rng.integers(2), 1.0])
    logs = np.zeros((n_times, truth.setting.n_ants, 2))
    logs[:, chosen] = size * rng.standard_normal((n_times, len(chosen), 2))
    truth.corruptions.append(multiplied(np.exp(logs[..., 0] + 1j * logs[..., 1])[np.newaxis]))
    parameters = [
        Parameter(antenna(truth, index), f"{what} at time {t}", unit, float(logs[t, index, part]))
        for index in chosen
        for part, (what, unit) in enumerate((("ln amplitude", ""), ("phase", "rad")))
        if size[part]
        for t in range(n_times)
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), len(parameters))


def gain_jump(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The gain of one antenna jumps by ``strength`` somewhere in the middle third of the night."""
    index, n_times = int(rng.integers(truth.setting.n_ants)), len(truth.setting.times)
    jump = int(rng.integers(n_times // 3, 2 * n_times // 3))
    change = strength * np.exp(2j * np.pi * rng.random())
    gains = np.ones((1, n_times, truth.setting.n_ants), dtype=complex)
    gains[0, jump:, index] += change
    truth.corruptions.append(multiplied(gains))
    log = np.log(1 + change)
    parameters = [
        Parameter(antenna(truth, index), f"{what}, jump before time {jump}", unit, float(value))
        for what, unit, value in (("ln amplitude", "", log.real), ("phase", "rad", log.imag))
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, [index])), 3, {"first time after it": jump})


def drifting_clock(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The clock runs slow or fast: ``strength`` seconds over the night, and right in the middle of it."""
    drift = float(strength * rng.choice([-1, 1]))
    truth.clock = drift * clock_of(truth)
    return Drawn([Parameter("clock", f"later, {DRIFT}", "s", drift)], n_params=1)


def clock_jump(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The clock is right until it is set, by ``strength`` seconds, somewhere in the middle third of the night."""
    n_times = len(truth.setting.times)
    jump, change = int(rng.integers(n_times // 3, 2 * n_times // 3)), float(strength * rng.choice([-1, 1]))
    truth.clock = np.where(np.arange(n_times) < jump, 0.0, change)
    told = [Parameter("clock", f"later, jump before time {jump}", "s", change)]
    return Drawn(told, n_params=2, about={"first time after it": jump})


def drifting_pointing(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One or three antennas turn by about ``strength`` degrees over the night, through the zenith."""
    clock, n_ants = clock_of(truth), truth.setting.n_ants
    chosen = some_antennas(truth, rng, (1, 3))
    drift = np.zeros((n_ants, 2))
    drift[chosen] = strength * rng.standard_normal((len(chosen), 2))

    def turned(index: int, channel: int, time: int, beam: Shape) -> Shape:
        return replace(beam, pointing=tuple(np.sin(np.deg2rad(clock[time] * drift[index])).tolist()))

    truth.shape_of_antenna |= {int(index): partial(turned, int(index)) for index in chosen}
    parameters = [
        Parameter(antenna(truth, index), f"tilted towards {direction}, {DRIFT}", "deg", float(value))
        for index in range(n_ants)
        for direction, value in zip(("East", "North"), drift[index], strict=True)
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 2 * len(chosen))


def drifting_coupling(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """What leaks into one or two baselines grows by ``strength`` Jy over the night, from below zero to above."""
    n = len(truth.setting.antpairs)
    chosen = sorted(rng.choice(n, int(rng.integers(1, 3)), replace=False).tolist())
    values = strength * np.exp(2j * np.pi * rng.random(len(chosen)))
    one, two = truth.setting.antpairs[chosen].T
    now = clock_of(truth)[:, np.newaxis] * values

    def corruption(vis: ComplexArray) -> ComplexArray:
        out = vis.copy()
        out[:, :, one, two] += now
        out[:, :, two, one] += now.conj()
        return out

    truth.corruptions.append(corruption)
    parameters = [
        Parameter(baseline(truth, bl), f"{part}, {DRIFT}", "Jy", float(number))
        for bl, value in zip(chosen, values, strict=True)
        for part, number in (("real", value.real), ("imaginary", value.imag))
    ]
    return Drawn(parameters, Where(antpairs=pairs(truth, chosen)), 2 * len(chosen))


def fading_source(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One of the strongest sources overhead loses the part ``strength`` of its mean flux over the night."""
    catalogue = truth.catalogue
    za, az = altaz(catalogue.ra, catalogue.dec, float(truth.setting.times[len(truth.setting.times) // 2]))
    seen = catalogue.flux * truth.setting.model_shape.power(za, az, REFERENCE_FREQ) * (za < np.pi / 2)
    source, clock = int(rng.choice(np.argsort(-seen)[:8])), clock_of(truth)

    def sky(channel: int, time: int, now: Catalogue) -> Catalogue:
        flux = now.flux.copy()
        flux[source] *= 1 - strength * clock[time]
        return Catalogue(now.ra, now.dec, flux, now.index)

    truth.sky_of.append(sky)
    return Drawn([Parameter(f"source {source}", f"relative change of flux, {DRIFT}", "", -strength)])


def fading_missing_source(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """A source that the catalogue lacks has ``strength`` Jy in the mean, and loses or gains 0.3 to 1.5 of that."""
    drawn = missing_source(truth, rng, strength)
    source, clock = len(truth.catalogue.flux) - 1, clock_of(truth)
    change = float(rng.choice([-1, 1]) * rng.uniform(0.3, 1.5))

    def sky(channel: int, time: int, now: Catalogue) -> Catalogue:
        flux = now.flux.copy()
        flux[source] *= 1 + change * clock[time]
        return Catalogue(now.ra, now.dec, flux, now.index)

    truth.sky_of.append(sky)
    *place, flux = drawn.parameters
    level = replace(flux, quantity="flux, level")
    drift = replace(flux, quantity=f"flux, {DRIFT}", value=change * flux.value)
    return Drawn([*place, level, drift], n_params=4)
