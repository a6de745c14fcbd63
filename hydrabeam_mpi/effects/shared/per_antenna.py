"""What effects with the same few parameters for every antenna have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.errors import InputError

LARGEST_LN = float(np.log(LARGEST))
"""Of the product of two gains, from where a fit may start but does not stay: its square is still a double."""


def logarithms(x: FloatArray) -> FloatArray:
    """Return a and phi of the factors exp(a + i phi) = 1 + x_0 + i x_1 that columns at zero stand for, (..., n).

    Beyond small errors the two differ: a lost sign, x_0 = -2, is a phase of pi and no amplitude, which no fit that
    begins at a = -2 comes to.
    """
    ln = logarithm_of(1 + x[..., 0::2] + 1j * x[..., 1::2])
    return np.stack([ln.real, ln.imag], axis=-1).reshape(x.shape)


def lost_signs(x: FloatArray) -> BoolArray:
    """Return which phases factors need that have a negative 1 + x_0, and no x_1, (n,); ``x`` is (..., n)."""
    needed = np.zeros(x.shape[-1], dtype=bool)
    rows = x.reshape(-1, len(needed))
    needed[1::2] = np.any(rows[:, 0::2] < -1, axis=0) & ~np.any(rows[:, 1::2], axis=0)
    return needed


def without_whole_turns(phases: FloatArray) -> FloatArray:
    """Return phases from -pi to pi, of the same shape, rad; those that are so as they are."""
    return np.asarray(phases - 2 * np.pi * np.round(phases / (2 * np.pi)))


def phases_without_turns(x: FloatArray) -> FloatArray:
    """Return a and phi of factors exp(a + i phi) with the phases nearest to zero, (..., n); ``x`` has both in turn."""
    return np.stack([x[..., 0::2], without_whole_turns(x[..., 1::2])], axis=-1).reshape(x.shape)


def logarithm_of(factors: ComplexArray) -> ComplexArray:
    """Return a + i phi of factors exp(a + i phi), of the same shape; of zero it is finite, too."""
    return np.asarray(np.log(np.maximum(np.abs(factors), np.exp(-LARGEST_LN))) + 1j * np.angle(factors))


def product_of_gains(first: ComplexArray, second: ComplexArray) -> ComplexArray:
    """Return g_j g_k* by the logarithms of both gains, of one shape; what is too large for a double is the largest."""
    logarithm = first + second.conj()
    return np.asarray(np.exp(logarithm.real.clip(-LARGEST_LN, LARGEST_LN) + 1j * logarithm.imag))


def antennas_named(setup: ObservingSetup, numbers: Sequence[int], field: str) -> IntArray:
    """Return the index of each antenna by its number, (n,).

    Raises
    ------
    InputError
        If no baseline has one of them, naming the ``field`` of the effect's settings.
    """
    known = setup.observation.antenna_numbers
    indices = {int(known[antenna]): int(antenna) for antenna in setup.antennas_in_use}
    unknown = sorted(set(numbers) - set(indices))
    if unknown:
        raise InputError(f"no baseline has antenna {unknown[0]}", field=field, remedy=f"name some of {sorted(indices)}")
    return np.array([indices[number] for number in numbers], dtype=int)


def antenna_parameters(
    setup: ObservingSetup, what: Sequence[str], unit: str | Sequence[str], scale: float
) -> Parameters:
    """Return parameters named "antenna 23 ...", one after another for each antenna in use, which are the elements.

    ``unit`` is that of all, or there is one for each of ``what``.
    """
    antennas = setup.antennas_in_use
    numbers = setup.observation.antenna_numbers[antennas]
    names = [f"antenna {number} {name}" for number in numbers for name in what]
    units = unit if isinstance(unit, str) else [*unit] * len(antennas)
    parameters = Parameters.of(names, units, scale, np.repeat(np.arange(len(antennas)), len(what)))
    return replace(parameters, sort=np.tile(np.arange(len(what)), len(antennas)) if len(what) > 1 else None)


def row_antennas(block: RowBlock) -> IntArray:
    """Return the positions of each row's first and second antenna among those in use, (Nbls, 2)."""
    return np.searchsorted(block.setup.antennas_in_use, np.stack([block.ant1, block.ant2], axis=1))


def row_parameters(block: RowBlock, n: int) -> IntArray:
    """Return the indices of the ``n`` parameters of a row's first antenna, then of its second, (Nbls, 2 n)."""
    return (n * row_antennas(block)[..., np.newaxis] + np.arange(n)).reshape(-1, 2 * n)


def common_values(n_antennas: int, n_each: int) -> FloatArray:
    """Return the combinations in which all antennas have the same value of one of their parameters, (n_each, q)."""
    return np.tile(np.eye(n_each), (1, n_antennas)) / np.sqrt(n_antennas)
