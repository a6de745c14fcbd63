"""Beams that are not all alike, not where they should be, or finer than the basis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, numbers, some_antennas
from tests.validation.undeclared.truth import Truth


def antenna_pointing(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One, three or all antennas are tilted by ``strength`` degrees to the East and to the North."""
    chosen = some_antennas(truth, rng)
    tilts = np.zeros((truth.setting.n_ants, 2))
    tilts[chosen] = strength * rng.standard_normal((len(chosen), 2))
    for index in chosen:
        pointing = tuple(np.sin(np.deg2rad(tilts[index])).tolist())
        truth.shapes[index] = replace(truth.shapes[index], pointing=pointing)
    parameters = [
        Parameter(antenna(truth, index), f"tilted towards {direction}", "deg", float(tilt))
        for index in range(truth.setting.n_ants)
        for direction, tilt in zip(("East", "North"), tilts[index], strict=True)
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 2 * len(chosen))


def nonredundant_beams(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Main lobes of one, three or all antennas are wider or narrower by ``strength`` along either axis.

    Their sidelobes differ by three times as much. At the zenith all are one: anything else there is a gain.
    """
    chosen = some_antennas(truth, rng)
    stretches = np.zeros((truth.setting.n_ants, 2))
    stretches[chosen] = strength * rng.standard_normal((len(chosen), 2))
    for index in chosen:
        shape = truth.shapes[index]
        width = tuple((np.array(shape.width) * np.exp(stretches[index])).tolist())
        level = shape.pedestal * np.exp(3 * strength * rng.standard_normal())
        truth.shapes[index] = replace(shape, width=width, pedestal=level)
    parameters = [
        Parameter(antenna(truth, index), f"width {direction}", "", float(np.expm1(stretch)))
        for index in range(truth.setting.n_ants)
        for direction, stretch in zip(("East-West", "North-South"), stretches[index], strict=True)
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 3 * len(chosen))


def basis_truncation(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The beam of all antennas has a ripple of ``strength`` that is finer than the basis, in radius or in azimuth."""
    phase = rng.uniform(0, 2 * np.pi)
    rings = bool(rng.integers(2))
    cycles, order = (rng.uniform(4.8, 5.6), 0.0) if rings else (rng.uniform(1.0, 2.0), 6.0)
    ripple = (strength, cycles, order, phase)
    # Antennas that share a beam go on sharing it.
    rippled = {id(shape): replace(shape, ripple=ripple) for shape in truth.shapes}
    truth.shapes = [rippled[id(shape)] for shape in truth.shapes]
    return Drawn(n_params=10)
