"""What is wrong with the file rather than with the world."""

from __future__ import annotations

import numpy as np

from tests.validation.undeclared.answer import Drawn
from tests.validation.undeclared.truth import Truth

TAI_LESS_UTC = 37.0  # seconds, since 2017


def conjugated(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Visibilities are those of the second antenna times the conjugate of the first."""
    truth.filed.append(np.conj)
    return Drawn()


def halved(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Visibilities are half of what they should be."""
    truth.filed.append(lambda data: 0.5 * data)
    return Drawn()


def doubled(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Visibilities are those of V = I B."""
    truth.filed.append(lambda data: 2 * data)
    return Drawn()


def north_and_east_exchanged(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Antenna positions have North first."""
    truth.antpos = truth.antpos[:, [1, 0, 2]]
    return Drawn()


def times_in_tai(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Times are TAI where the file should have UTC: they are later than the data were taken."""
    truth.clock = -TAI_LESS_UTC
    return Drawn()


def antennas_sorted_by_name(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Positions stand in the order of the names as text, "A10" before "A2"."""
    order = np.argsort([f"A{number}" for number in truth.setting.numbers])
    truth.antpos = truth.antpos[np.argsort(order)]
    return Drawn(about={"antennas that moved": float(np.sum(order != np.arange(len(order))))})
