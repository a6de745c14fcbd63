"""What effects of single point sources share: their visibilities, maps of the residual, and which to tell apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from hydrabeam_mpi.data.observation import C_M_PER_S, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.shared.settings import Azimuth, Count, Elevation
from hydrabeam_mpi.model.engines.base import SOURCES_AT_ONCE, amplitude
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.positions import ManyDirections
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.model.sky import Sky, separation

STEP = 2e-4
"""Of derivatives by place, in resolutions, over each of which phases turn once on the longest baseline: central
differences lack 3e-7 of them, and rounding errors less."""
HALF_WIDTH = 64  # samples of the beam from the zenith to the horizon, where a map does with an interpolated one


class PointSources(ScannedEffect):
    """An effect whose elements are single sources, the same in all channels.

    Parameters
    ----------
    sources : sequence of (float, float)
        Right ascension and declination, degrees.
    trials : int
        Number of candidates from which these were picked.
    """

    changes_sky = True
    shared = True
    of_the_sky = True
    unphysical = "a flux below zero"

    def __init__(self, sources: Sequence[tuple[Azimuth, Elevation]] = (), trials: Count = 1) -> None:
        self.sources = tuple((float(ra), float(dec)) for ra, dec in sources)
        self.trials = trials

    def _fluxes_below_zero(self, least: float, x: FloatArray, std: FloatArray) -> FloatArray:
        """Return how far each source's first parameter, that of its flux, is below ``least``, as `Effect.beyond`."""
        below, first = np.zeros(x.shape[1]), slice(None, None, x.shape[1] // len(self.sources))
        below[first] = sigmas(least - x, std)[:, first].max(axis=0)
        return below

    def without(self, gone: BoolArray) -> tuple[Self, IntArray]:
        """Return the other sources, and the numbers of their parameters, (n_left,); ``gone`` is (n_params,)."""
        stays = ~np.any(gone.reshape(len(self.sources), -1), axis=1)
        return self.some(np.flatnonzero(stays)), np.flatnonzero(np.repeat(stays, len(gone) // len(stays)))

    def some(self, which: IntArray) -> Self:
        """Return the effect of some of its sources, (Nleft,)."""
        return self.of([self.sources[n] for n in which.tolist()], self.trials)

    def of(self, sources: Sequence[tuple[float, float]], trials: int = 1) -> Self:
        """Return the same effect of other sources."""
        return type(self)(sources, trials)

    def describe(self) -> dict[str, Any]:
        """Return which sources, and from how many they were picked."""
        return {"sources": [list(source) for source in self.sources], "trials": self.trials}


def resolution(setup: ObservingSetup) -> float:
    """Return the finest fringe's spacing, c / (nu_max b_max), radians; at most a hemisphere."""
    longest = float(np.linalg.norm(setup.redundant.vectors, axis=1).max(initial=0.0))
    return min(C_M_PER_S / (float(setup.observation.freqs.max()) * max(longest, 1e-3)), np.pi)


def keep_apart(ra: FloatArray, dec: FloatArray, distance: float, at_most: int) -> IntArray:
    """Choose directions, the first ones first, that are farther than ``distance`` radians from those chosen before.

    All are (N,), of which the indices (Nchosen,) are returned.
    """
    chosen: list[int] = []
    left = np.arange(len(ra))
    while len(left) and len(chosen) < at_most:
        best = int(left[0])
        chosen.append(best)
        left = left[separation(ra[left], dec[left], ra[best], dec[best]) > distance]
    return np.array(chosen, dtype=int)


def in_degrees(ra: FloatArray, dec: FloatArray) -> tuple[tuple[float, float], ...]:
    """Return directions as they are told and stored, pairs (ra, dec) in degrees."""
    return tuple(zip(np.rad2deg(ra).tolist(), np.rad2deg(dec).tolist(), strict=True))


def in_radians(sources: Sequence[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    """Return right ascensions and declinations of pairs in degrees, (N,) each."""
    ra, dec = np.deg2rad(np.reshape(np.asarray(sources, dtype=float), (-1, 2))).T
    return ra, dec


def on_tangent_plane(
    ra: FloatArray, dec: FloatArray, ra_at: FloatArray | float, dec_at: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Return how far directions lie east and north on the plane tangent at others, (N,) each, in its radii."""
    along = np.sin(dec_at) * np.sin(dec) + np.cos(dec_at) * np.cos(dec) * np.cos(ra - ra_at)
    east = np.cos(dec) * np.sin(ra - ra_at)
    north = np.cos(dec_at) * np.sin(dec) - np.sin(dec_at) * np.cos(dec) * np.cos(ra - ra_at)
    return east / along, north / along


def beside(ra: FloatArray, dec: FloatArray, east: FloatArray, north: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the directions east and north of others on the plane tangent there, the inverse of `on_tangent_plane`.

    All are (N,), radians.
    """
    along = np.cos(dec) - north * np.sin(dec)
    x, y = along * np.cos(ra) - east * np.sin(ra), along * np.sin(ra) + east * np.cos(ra)
    return np.arctan2(y, x), np.arctan2(np.sin(dec) + north * np.cos(dec), np.hypot(x, y))


def place(ra: float, dec: float) -> str:
    """Tell a direction, in degrees."""
    return f"ra={ra:.3f} dec={dec:.3f}"


def responses(block: RowBlock, ra: FloatArray, dec: FloatArray) -> ComplexArray:
    """Return the visibilities of sources of 1 Jy, (Ntimes, Ngroups, N); zero while below the horizon.

    For few sources: all their fringes are held. Places are (N,), or (Ntimes, N) where they move.
    """
    n = ra.shape[-1]
    out = np.zeros((len(block.times), len(block.groups), n), dtype=complex)
    if not n:
        return out
    at_times = [(ra, dec)] * len(block.times) if ra.ndim == 1 else zip(ra, dec, strict=True)
    up = [block.follow(*at).above_horizon(t) for t, at in zip(block.times.tolist(), at_times, strict=True)]
    # Several times at once, as the sources are few.
    step = max(1, SOURCES_AT_ONCE // n)
    for lo in range(0, len(up), step):
        index, za, az = (np.concatenate(parts) for parts in zip(*up[lo : lo + step], strict=True))
        time = np.repeat(np.arange(len(up))[lo : lo + step], [len(one) for one, *_ in up[lo : lo + step]])
        beam = np.asarray(block.beam(za, az)).real
        out[time, :, index] = block.engine.responses(enu(za, az), beam, block.freq).T
    return out


def with_slopes(
    block: RowBlock, where: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
) -> tuple[ComplexArray, ComplexArray]:
    """Return visibilities of sources of 1 Jy, (Ntimes, Ngroups, N), and their derivatives by place, (2, ...).

    Parameters
    ----------
    block : RowBlock
    where : callable
        From a shift, (2,) radians east and north, to the places as of `responses`.

    Returns
    -------
    seen, slopes : ndarray of complex
        The latter by radians east and north, central differences; zero where the horizon lies between.
    """
    step = STEP * resolution(block.setup)
    shifts = step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], dtype=float)
    # One pass over the times serves all displacements.
    places = zip(*map(where, shifts), strict=True)
    seen, *displaced = np.split(responses(block, *(np.concatenate(axis, axis=-1) for axis in places)), 5, axis=2)
    ahead, behind = np.array(displaced[::2]), np.array(displaced[1::2])
    return seen, np.where((ahead != 0) & (behind != 0), (ahead - behind) / (2 * step), 0)


def dirty_map(
    block: RowBlock, sky: Sky, functions: FloatArray | Callable[[FloatArray], FloatArray] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Correlate the residual with every source of a sky by itself, as it is or with each of some functions.

    Redundant baselines are summed first, and the beam is interpolated between samples. Nothing larger than the sky and
    the fringes of a few of its sources is held.

    Parameters
    ----------
    block : RowBlock
    sky : Sky
        Sources at the setup's channels; many.
    functions : ndarray, (Ntimes, k), or callable, optional
        Of time, at the block's times; or of ENU directions (3, N), of which it makes (N, k). By default one, for
        sources as they are.

    Returns
    -------
    projection, power : ndarray, (Nsrc, k)
        Re sum w s* r and sum w |s|^2 over the block's rows, s being a source's visibilities times a function.
    """
    functions = np.ones((len(block.times), 1)) if functions is None else functions
    n_functions = (functions(np.eye(3)) if callable(functions) else functions).shape[1]
    projection, power = (np.zeros((sky.Nsrc, n_functions)) for _ in range(2))
    summed = block.summed(block.weights * block.residual)
    weights = block.weights.sum(axis=1)
    if not weights.any():
        return projection, power
    beam, every = sampled(block.beam), ManyDirections(block.positions, sky)
    for t in np.flatnonzero(weights).tolist():
        index, directions = every.above_horizon(int(block.times[t]))
        seen = sky.flux[block.channel, index] * beam(directions)
        told = block.engine.adjoint(summed[t], directions, seen, block.freq)
        now = functions(directions) if callable(functions) else functions[t]
        projection[index] += told[:, np.newaxis] * now
        power[index] += weights[t] * amplitude(seen)[:, np.newaxis] ** 2 * now**2
    return projection, power


def sampled(beam: Beam) -> Callable[[FloatArray], FloatArray]:
    """Return the beam as a function of unit vectors (3, N), interpolated by cubic splines between samples.

    The samples lie on Lambert's equal-area plane around the zenith, whose unit circle is the horizon: smooth there and
    at the zenith, and reached from unit vectors without trigonometry.
    """
    margin = 4  # the spline's reach beyond the horizon
    axis = np.arange(-HALF_WIDTH - margin, HALF_WIDTH + margin + 1) / HALF_WIDTH
    east, north = np.meshgrid(axis, axis, indexing="ij")
    za = 2 * np.arcsin(np.minimum(np.hypot(east, north), 1.0) / np.sqrt(2))
    az = np.arctan2(north, east) % (2 * np.pi)
    values = np.asarray(beam(za.ravel(), az.ravel())).real.reshape(za.shape)
    coefficients = spline_filter(values, order=3)

    def interpolate(directions: FloatArray) -> FloatArray:
        onto = HALF_WIDTH / np.sqrt(1 + directions[2])
        places = directions[:2] * onto + (HALF_WIDTH + margin)
        return np.asarray(map_coordinates(coefficients, places, order=3, prefilter=False))

    return interpolate
