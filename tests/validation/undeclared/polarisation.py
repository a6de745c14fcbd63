"""Feeds that hear each other: V -> J V J^H with J = [[1, d_e], [d_n, 1]] of each antenna."""

from __future__ import annotations

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, numbers, some_antennas
from tests.validation.undeclared.truth import ComplexArray, Truth


def leakage(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Part ``strength`` of each feed's signal gets into the other one, of one, three or all antennas."""
    chosen = some_antennas(truth, rng)
    truth.leakage = np.zeros((truth.setting.n_ants, 2), dtype=complex)
    draws = rng.standard_normal((2, len(chosen), 2))
    truth.leakage[chosen] = strength * (draws[0] + 1j * draws[1]) / np.sqrt(2)
    parameters = [
        Parameter(antenna(truth, index), f"feed {feed} leakage, {part} part", "", float(value))
        for index in range(truth.setting.n_ants)
        for feed, term in zip("en", truth.leakage[index], strict=True)
        for part, value in (("real", term.real), ("imaginary", term.imag))
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 4 * len(chosen))


def polarised(truth: Truth, vis: ComplexArray) -> dict[str, ComplexArray]:
    """Return all polarisations that the file has, each (Nfreqs, Ntimes, Nants, Nants).

    The sky is unpolarised, the feeds are ideal and have the same power beam, so that without leakage "ee" and "nn" are
    the same and the others zero.
    """
    if truth.leakage is None:
        return {"ee": vis}
    into_east, into_north = (truth.leakage[:, feed] for feed in (0, 1))
    first, second = (lambda d: d[:, np.newaxis]), (lambda d: d.conj()[np.newaxis])
    return {
        "ee": vis * (1 + first(into_east) * second(into_east)),
        "nn": vis * (1 + first(into_north) * second(into_north)),
        "en": vis * (first(into_east) + second(into_north)),
        "ne": vis * (first(into_north) + second(into_east)),
    }
