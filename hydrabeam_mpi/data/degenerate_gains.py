"""Gains of antennas without what no data of an array with one beam tell of them.

The same amplitude of all antennas is another scale of beam or sky, the same phase has no effect, and a phase that grows
along the ground moves the sky as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray

STEPS = 4
"""Trial gradients a turn of phase across the array: what lies between two is found by least squares."""
LARGEST_SEARCH = 401
"""Trial gradients along an axis, at most; then steeper ones are not looked for."""


@dataclass(frozen=True)
class Degenerate:
    """What has been taken off gains: ln amplitude, phase (rad), and its gradient East and North (rad/m)."""

    ln_amplitude: float
    phase: float
    gradient: tuple[float, float]


def without_degenerate(
    ln_amplitude: Array, phase: Array, positions: Array, common: BoolArray | bool = True
) -> tuple[FloatArray, FloatArray, Degenerate]:
    """Return ln amplitudes and phases, (Nants,), less their degenerate part.

    Parameters
    ----------
    ln_amplitude, phase : ndarray, (Nants,)
        Radians; NaN of antennas that are not known. Phases may wrap.
    positions : ndarray, (Nants, 2)
        Metres East and North.
    common : ndarray of bool, (Nants,), optional
        Antennas that decide what is degenerate: those that all gains have which are to be compared.
    """
    known = common & np.isfinite(ln_amplitude) & np.isfinite(phase)
    if not known.any():
        return ln_amplitude, phase, Degenerate(0.0, 0.0, (0.0, 0.0))
    design = phase_directions(positions)
    gradient = _steepest(phase[known], positions[known] - positions[known].mean(axis=0))
    centre = positions[known].mean(axis=0)
    turn = np.angle(np.exp(1j * (phase[known] - (positions[known] - centre) @ gradient)).mean())
    plane = np.array([turn - centre @ gradient, *gradient])
    left = _wrapped(phase - design @ plane)
    rest = np.linalg.pinv(design[known]) @ left[known]
    plane = plane + rest
    mean = float(ln_amplitude[known].mean())
    found = Degenerate(mean, float(_wrapped(plane[0])), (float(plane[1]), float(plane[2])))
    return ln_amplitude - mean, left - design @ rest, found


def phase_directions(positions: Array) -> FloatArray:
    """Return the degenerate directions of phases, (Nants, 3), of antennas at (Nants, 2) metres East and North."""
    return np.column_stack([np.ones(len(positions)), positions])


def _steepest(phase: Array, positions: Array) -> FloatArray:
    """Return the gradient, (2,) rad/m, along which phases line up best; the flattest of equally good ones."""
    extent = np.abs(positions).max(axis=0)
    apart = np.linalg.norm(positions[:, np.newaxis] - positions, axis=-1)
    nearest = apart[apart > 0].min() if np.any(apart > 0) else np.inf
    axes = []
    for reach in extent:
        step = np.pi / STEPS / reach if reach else np.inf
        n = 0 if np.isinf(step) else min(int(np.pi / nearest / step), LARGEST_SEARCH // 2)
        axes.append(step * np.arange(-n, n + 1) if n else np.zeros(1))
    phasors = [np.exp(-1j * np.multiply.outer(axis, along)) for axis, along in zip(axes, positions.T, strict=True)]
    height = np.abs(np.einsum("ea,na->en", phasors[0] * np.exp(1j * phase), phasors[1]))
    steepness = np.hypot(axes[0][:, np.newaxis], axes[1])
    # Redundant arrays have the same height at gradients of a turn a spacing.
    best = np.unravel_index(np.argmin(np.where(height >= height.max() * (1 - 1e-9), steepness, np.inf)), height.shape)
    return np.array([axes[0][best[0]], axes[1][best[1]]])


def _wrapped(phase: Array) -> Array:
    """Return phases between -pi and pi."""
    return np.angle(np.exp(1j * phase))
