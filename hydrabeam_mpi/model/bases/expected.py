"""Which modes are expected to be large by those that are near in radial and azimuthal order."""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.model.bases.base import NEGLIGIBLE, has_part

Mode = tuple[int, int]
"""(k, m)."""

MARGIN = 4
"""Orders beyond those of a basis that has all of its own; enough for as many modes again."""

ODD = 3.0
"""ln of how much smaller modes of odd m are than those of even m: most feeds look alike when turned by half a turn."""

FINE, FINE_K, FINE_M = 5e-3, 10.0, 5.0
"""The fine structure of beams that no formula has: amplitudes FINE (1 + k / FINE_K)^-3/2 e^(-|m| / FINE_M), relative to
the largest. Within a factor of three, mostly, that is what simulated beams of HERA's dipole and Vivaldi feeds have from
81 to 131 MHz up to k = 60 and |m| = 24, where it is more than the main lobe leaves."""

GUESSED = 3.0
"""Widths of a prior over what is expected of the modes of a formula.

A simulated feed is up to 2.1 times as far (rms) from an Airy or a Gaussian beam as that, and single modes are more.
Three times too wide costs little. Too narrow, what the beam may not have is found elsewhere, as in sources that vary.
"""


def expected_amplitudes(modes: Sequence[tuple[int, int]], amplitudes: FloatArray) -> FloatArray:
    """Return how large modes are expected to be by those of a basis that are near.

    A mode is expected to be as large as any other reduced by a factor e for each step in k and in |m|, and by e^3 more
    where one |m| is even and the other odd. Of the modes that a selection by amplitude has left out of dipole and dish
    beams, this finds more than do smooth fits or order alone. A model that has no part in some functions is simpler
    than any beam, such as a formula; there all modes are expected to have what the fine structure of beams has.

    Parameters
    ----------
    modes : sequence of (k, m)
        Of the basis; k = 1, 2, ...
    amplitudes : ndarray, (len(modes),)
        How large their coefficients are.

    Returns
    -------
    ndarray, (Nk, Nm)
        Of the modes (k, m) and (k, -m) at [k - 1, m].
    """
    logs = np.log(np.maximum(amplitudes, NEGLIGIBLE * amplitudes.max()))
    k, m = np.array(modes).T
    expected = np.full((k.max() + MARGIN, abs(m).max() + 1 + MARGIN), -np.inf)
    np.maximum.at(expected, (k - 1, abs(m)), logs)
    steps_k, steps_m = (abs(np.subtract.outer(np.arange(n), np.arange(n))) for n in expected.shape)
    steps_m = steps_m + ODD * (steps_m % 2)
    expected = (expected - steps_k[:, :, np.newaxis]).max(axis=1)
    expected = (expected[:, np.newaxis] - steps_m).max(axis=2)
    if is_idealised(amplitudes):
        k, m = np.ogrid[1 : len(expected) + 1, : expected.shape[1]]
        fine = np.log(FINE) - 1.5 * np.log1p(k / FINE_K) - m / FINE_M - ODD * (m % 2)
        expected = np.maximum(expected, logs.max() + fine)
    return np.exp(expected)


def is_idealised(amplitudes: FloatArray) -> bool:
    """Whether a model beam of these amplitudes, (n_modes,), has no part in some functions, but for rounding errors."""
    return not has_part(amplitudes).all()


def expected_of_all(modes: Sequence[tuple[int, int]], amplitudes: FloatArray) -> FloatArray:
    """Return how large modes may be, (len(modes),): `GUESSED` of a formula, of other models as they are.

    Arguments are those of `expected_amplitudes`.
    """
    if not is_idealised(amplitudes) or not amplitudes.any():
        return amplitudes
    k, m = np.array(modes).T
    return GUESSED * expected_amplitudes(modes, amplitudes)[k - 1, abs(m)]


def _lacking(expected: FloatArray, present: Container[Mode]) -> list[list[Mode]]:
    """Return the modes that are not ``present``, those first that are expected to be largest; m and -m come together.

    ``expected``, (Nk, Nm), is that of `expected_amplitudes`.
    """
    places = [divmod(place, expected.shape[1]) for place in np.argsort(-expected, axis=None, kind="stable").tolist()]
    return _without([list(dict.fromkeys([(row + 1, m), (row + 1, -m)])) for row, m in places], present)


def _without(pairs: Sequence[list[Mode]], gone: Container[Mode]) -> list[list[Mode]]:
    """Return what is left of modes that come together when some are ``gone``."""
    return [left for pair in pairs if (left := [mode for mode in pair if mode not in gone])]


def _first(pairs: Sequence[list[Mode]], most: int) -> list[Mode]:
    """Return the first modes, ``most`` or fewer; where one place is left, the next one that is alone takes it."""
    chosen: list[Mode] = []
    for pair in pairs:
        if len(chosen) == most:
            break
        if len(chosen) + len(pair) <= most:
            chosen += pair
    return chosen


def next_expected(
    modes: Sequence[tuple[int, int]],
    amplitudes: FloatArray,
    before: Sequence[tuple[int, int]],
    n_before: int,
    most: int,
) -> tuple[list[tuple[int, int]], FloatArray]:
    """Return the first modes, ``most`` or fewer, that come when others have taken ``n_before`` of them.

    Parameters
    ----------
    modes, amplitudes
        As for `expected_amplitudes`.
    before : sequence of (k, m)
        Modes that come before all that are expected by others.
    n_before, most : int

    Returns
    -------
    modes : list of (k, m)
    sizes : ndarray, (len(modes),)
        How large they are expected; those that come ``before`` the others as the smallest of the basis.
    """
    expected = expected_amplitudes(modes, amplitudes)
    first, pairs, n_taken = list(before), _lacking(expected, set(modes)), 0
    while True:
        new = first[:most]
        n_first = len(new)
        new += _first(pairs, most - n_first)
        if not new or n_taken >= n_before:
            break
        taken = new[: n_before - n_taken]
        first, pairs, n_taken = first[len(taken) :], _without(pairs, set(taken)), n_taken + len(taken)
    least = smallest(amplitudes, len(new)) if n_first else 0.0
    sizes = [least] * n_first + [expected[k - 1, abs(m)] for k, m in new[n_first:]]
    return new, np.array(sizes, dtype=float)


def smallest(amplitudes: FloatArray, n: int) -> float:
    """Return the median of the ``n`` smallest of the amplitudes, (n_modes,), that are not rounding errors."""
    told = np.sort(amplitudes[has_part(amplitudes)])
    return float(np.median(told[:n]))
