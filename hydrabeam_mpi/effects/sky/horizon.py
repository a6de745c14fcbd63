"""Obstruction near the horizon: what lies below a skyline is seen through a transmission 1 + x."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.settings import Azimuth, Count, Elevation

HIGHEST = 20.0
"""Elevation up to which something may stand, degrees: hills are as high from valleys that keep interference out."""
HEIGHTS = 80  # rings of a quarter of a degree, with few sources each; strips along its rim refine a wall
SECTORS = 72
RING, WIDTH = HIGHEST / HEIGHTS, 360.0 / SECTORS  # degrees
STARTS: IntArray = np.append(np.tile(np.arange(SECTORS), SECTORS - 1), 0)
LENGTHS: IntArray = np.append(np.repeat(np.arange(1, SECTORS), SECTORS), SECTORS)
"""First sector and number of sectors of every wall; one stands all around."""
AT_MOST = 8
SAME = 0.6  # part of their joint area that two walls share beyond which they are taken as one
STRIPS = 10  # on either side of an edge
UNKNOWN = 0.33  # natural size of what a strip transmits otherwise than its wall has it

Box = tuple[Azimuth, Azimuth, Elevation, Elevation]
"""First and last azimuth, lowest and highest elevation, degrees."""


class Horizon(ScannedEffect):
    """Transmission of walls that stand on the horizon, less one; each channel its own.

    A wall hides everything below a height of at most twenty degrees from one azimuth to another (from East through
    North). Walls add up, so that any skyline is a sum of them, and one that is opaque has x = -1.

    Where a wall ends is told by sources that are seen beside it and others that are not, and unknown in between. So its
    rim is cut into strips that have few sources each, with a transmission of their own beside that of the wall: data
    that have a source there refine the skyline, and for others it stays unknown whether it is seen.

    Parameters
    ----------
    walls : sequence of (float, float, float, float)
        First and last azimuth, lowest and highest elevation, degrees.
    strips : sequence of (int, (float, float, float, float))
        Number of a wall, and such limits of a piece of its rim.
    trials : int
        Number of walls from which these were picked.
    """

    kind = "horizon"
    title = "obstruction near the horizon"
    changes_sky = True
    of_the_sky = True
    unphysical = "a transmission that is not between 0 and 1"

    def __init__(self, walls: Sequence[Box] = (), strips: Sequence[tuple[int, Box]] = (), trials: Count = 1) -> None:
        self.walls = [_box(wall) for wall in walls]
        self.strips = [(int(wall), _box(strip)) for wall, strip in strips]
        self.trials = trials
        if any(not 0 <= wall < len(self.walls) for wall, _ in self.strips):
            raise ValueError("a strip is of a wall that there is not")

    def describe(self) -> dict[str, Any]:
        """Return which walls with which strips, and from how many they were picked."""
        strips = [[wall, list(strip)] for wall, strip in self.strips]
        return {"walls": [list(wall) for wall in self.walls], "strips": strips, "trials": self.trials}

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the walls' transmissions less one, each of which may stand by itself, and what strips have more."""
        n, more = len(self.walls), len(self.strips)
        names = [_called(wall) for wall in self.walls]
        names += [f"rim of {names[wall]}: {_called(strip)}" for wall, strip in self.strips]
        element = np.append(np.arange(n), [wall for wall, _ in self.strips]).astype(int)
        scale = np.repeat([1.0, UNKNOWN], [n, more])
        nonlinear = [False] * n + [True] * more
        return Parameters.of(names, "", scale, element, nonlinear, max(self.trials, n) if n else 0)

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return what each box changes of the transmission; see `Effect.told`."""
        told = super().told(setup, x, std)
        return replace(told, names=tuple(f"change of transmission at {name}" for name in told.names))

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray:
        """Return each source's transmission, (Nsrc,)."""
        factor = np.ones(len(sources.za))
        low, inside = self._inside(sources)
        factor[low] += inside.T @ x
        return factor

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the visibilities of what is in each wall and strip; ``x`` is (n_params,)."""
        values = np.zeros((len(block.times), len(block.groups), len(x)), dtype=complex)
        for t, itime in enumerate(block.times.tolist()):
            sources = block.sources(itime)
            low, inside = self._inside(sources)
            values[t] = (inside @ _seen(block, sources, low)).T
        return Columns(values, len(x), by_group=True)

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse transmissions outside 0 to 1, and walls that mostly make sources brighter; see `Effect.beyond`.

        What is seen in the middle of each box is changed by all that hold it. What changes there is due to the last of
        those that push that way: walls come before their strips, and better walls before others. No obstruction
        makes sources brighter, but another beam may; within a wall it may be a hole.
        """
        boxes = np.array([*self.walls, *(strip for _, strip in self.strips)])
        middle = 0.5 * (boxes[:, ::2] + boxes[:, 1::2])
        after = (middle[:, 0] - boxes[:, :1]) % 360
        holds = (after < (boxes[:, 1] - boxes[:, 0])[:, np.newaxis]) & (middle[:, 1] >= boxes[:, 2:3])
        holds &= middle[:, 1] < boxes[:, 3:]
        change, error = x @ holds, np.where(std > 0, np.sqrt(std**2 @ holds), 0.0)
        n = len(self.walls)
        of_wall = [*range(n), *(wall for wall, _ in self.strips)]
        beyond, brighter = np.zeros(x.shape[1]), np.zeros(n)
        for sign, limit in ((1, 0.0), (-1, 1.0)):
            for f, place in np.argwhere(much := sigmas(sign * change, error)):
                last = np.flatnonzero(holds[:, place] & (sign * x[f] > 0))[-1]
                hole = sign > 0 and np.any(holds[:n, place] & (x[f, :n] < 0))
                brighter[of_wall[last]] += 0.0 if hole else sign * much[f, place] ** 2
                beyond[last] = max(beyond[last], (sign * change[f, place] - limit) / error[f, place])
        beyond[:n] = np.where(brighter > 0, np.inf, beyond[:n])
        return beyond

    def without(self, gone: BoolArray) -> tuple[Self, IntArray]:
        """Return the other walls and their strips that stay, and the parameters' numbers, (n_left,).

        ``gone`` is (n_params,).
        """
        n = len(self.walls)
        walls = np.flatnonzero(~gone[:n])
        strips = [i for i, (wall, _) in enumerate(self.strips) if not (gone[n + i] or gone[wall])]
        number = {wall: i for i, wall in enumerate(walls.tolist())}
        kept = [(number[self.strips[i][0]], self.strips[i][1]) for i in strips]
        left = np.append(walls, n + np.array(strips, dtype=int))
        return type(self)([self.walls[wall] for wall in walls], kept, self.trials), left

    def _inside(self, sources: Sources) -> tuple[IntArray, Any]:
        """Return which sources are low, and which of those are in each wall and strip, (n, Nlow), sparse."""
        boxes = [*self.walls, *(strip for _, strip in self.strips)]
        first, last, lowest, highest = np.reshape(np.array(boxes), (-1, 4)).T
        low = _below(sources, float(highest.max(initial=0.0)))
        elevation, az = 90 - np.rad2deg(sources.za[low]), np.rad2deg(sources.az[low]) % 360
        # Boxes are stretches of the sources in the order of azimuth, twice around.
        order = np.argsort(az)
        order = np.concatenate([order, order])
        around = az[order] + np.repeat([0, 360], len(low))
        start, end = (np.searchsorted(around, first % 360 + more) for more in (0, last - first))
        box = np.repeat(np.arange(len(boxes)), end - start)
        source = order[np.arange(len(box)) - np.repeat(np.cumsum(end - start) - end, end - start)]
        inside = (elevation[source] >= lowest[box]) & (elevation[source] < highest[box])
        entries = np.ones(inside.sum()), (box[inside], source[inside])
        return low, csr_array(entries, shape=(len(boxes), len(low)))

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of walls that are looked at."""
        return len(STARTS) * HEIGHTS

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with every wall, its sources taken as orthogonal, each (n_hypotheses, p)."""
        residual, weights = block.summed(block.weights * block.residual), block.summed(block.weights)
        cells = np.zeros((2, SECTORS * HEIGHTS))
        for t in np.flatnonzero(weights.any(axis=1)).tolist():
            sources = block.sources(int(block.times[t]))
            low = _below(sources, HIGHEST)
            seen = _seen(block, sources, low)
            ring = np.clip(((90 - np.rad2deg(sources.za[low])) / RING).astype(int), 0, HEIGHTS - 1)
            sector = (np.rad2deg(sources.az[low]) / WIDTH).astype(int) % SECTORS
            cell = sector * HEIGHTS + ring
            np.add.at(cells[0], cell, (seen.conj() @ residual[t]).real)
            np.add.at(cells[1], cell, np.abs(seen) ** 2 @ weights[t])
        below = np.cumsum(cells.reshape(2, SECTORS, HEIGHTS), axis=2)
        # All sectors from the first, twice around, to take differences of.
        around = np.cumsum(np.concatenate([np.zeros((2, 1, HEIGHTS)), below, below], axis=1), axis=1)
        projection, power = (around[:, STARTS + LENGTHS] - around[:, STARTS]).reshape(2, -1, 1)
        return projection, power

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> Horizon:
        """Take these walls, the best first, leaving out those that are much the same as better ones.

        ``hypotheses`` is (Nchosen,).
        """
        window, height = np.divmod(hypotheses, HEIGHTS)
        chosen: list[int] = []
        for one in range(len(hypotheses)):
            overlaps = [_overlap(window[[one, two]], height[[one, two]] + 1) for two in chosen]
            if max(overlaps, default=0.0) < SAME and len(chosen) < AT_MOST:
                chosen.append(one)
        first, last = WIDTH * STARTS[window], WIDTH * (STARTS + LENGTHS)[window]
        top = RING * (height + 1)
        walls = [(float(first[i]), float(last[i]), 0.0, float(top[i])) for i in chosen]
        elevation, az = _places(setup)
        strips = [(i, strip) for i, wall in enumerate(walls) for strip in _rim(wall, elevation, az)]
        return Horizon(walls, strips, self.n_hypotheses(setup))

    def drawn(self, setup: ObservingSetup, rng: np.random.Generator) -> Horizon:
        """Put up a wall at random, as wide as a quarter of the horizon or wider."""
        quarter = np.flatnonzero(np.repeat(LENGTHS >= SECTORS // 4, HEIGHTS))
        return self.at(setup, rng.choice(quarter, size=1))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw losses of rms ``strength`` x scale behind walls, at most all; their rims are as they are.

        The result is (n_params,).
        """
        parameters = self.parameters(setup)
        losses = np.minimum(strength * np.abs(rng.standard_normal(len(parameters))), 1.0)
        return np.where(parameters.nonlinear, 0.0, -losses)


def _below(sources: Sources, elevation: float) -> IntArray:
    """Return which sources are below an elevation, degrees."""
    return np.flatnonzero(sources.za > np.deg2rad(90 - elevation))


def _seen(block: RowBlock, sources: Sources, which: IntArray) -> ComplexArray:
    """Return the visibilities of some sources with nothing before them, (N, Ngroups)."""
    seen = sources.flux_without(Horizon.kind)[which] * sources.beam[which]
    return block.engine.responses(sources.enu[:, which], seen, block.freq).T


def _box(limits: Sequence[float]) -> Box:
    first, last, lowest, highest = (float(limit) for limit in limits)
    return first, last, lowest, highest


def _called(box: Box) -> str:
    first, last, lowest, highest = box
    where = f"az {first:.4g}-{last:.4g} deg" if last - first < 360 else "all azimuths"
    return f"elevation {lowest:.4g}-{highest:.4g} deg, {where}"


def _overlap(windows: IntArray, heights: IntArray) -> float:
    """Return the overlap of two walls as a fraction of their joint area."""
    sectors = np.zeros((2, SECTORS), dtype=bool)
    for row, window in zip(sectors, windows.tolist(), strict=True):
        row[(STARTS[window] + np.arange(LENGTHS[window])) % SECTORS] = True
    both = float(np.sum(sectors[0] & sectors[1]) * heights.min())
    return both / (float(sectors.sum(axis=1) @ heights) - both)


def _places(setup: ObservingSetup) -> tuple[FloatArray, FloatArray]:
    """Return elevation and azimuth of sources near or below the highest walls, at all times in use, degrees."""
    positions = setup.positions(setup.sky, setup.observation)
    parts = []
    for itime in setup.times.tolist():
        _, za, az = positions.above_horizon(itime)
        parts.append(np.rad2deg([np.pi / 2 - za, az])[:, za > np.deg2rad(90 - 2 * HIGHEST)])
    elevation, az = np.concatenate([np.zeros((2, 0)), *parts], axis=1)
    return elevation, az


def _rim(wall: Box, elevation: FloatArray, az: FloatArray) -> list[Box]:
    """Return the strips along a wall's edges, given where sources are.

    They reach as far as the next wall that is looked at, and farther where there are few sources.
    """
    first, last, _, top = wall
    after = (az - first) % 360
    within = after < last - first
    rim = [(first, last, max(lo, 0.0), hi) for lo, hi in _strips(elevation[within] - top, RING, top)]
    if last - first < 360:
        below = elevation < top
        for edge in (first, last):
            beyond = (az[below] - edge + 180) % 360 - 180
            rim += [(lo, hi, 0.0, top) for lo, hi in _strips(beyond, WIDTH, edge)]
    return rim


def _strips(distance: FloatArray, reach: float, edge: float) -> list[tuple[float, float]]:
    """Cut both sides of an edge into strips with as many sources each, one or more."""
    strips = []
    for sign in (-1, 1):
        beyond = np.sort(sign * distance[sign * distance >= 0])
        n = min(max(STRIPS, int(np.searchsorted(beyond, reach))), len(beyond))
        if n == 0:
            continue
        cuts = np.unique(np.round(np.linspace(0, n, STRIPS + 1)).astype(int))[1:]
        ends = 0.5 * (beyond[cuts - 1] + np.append(beyond, beyond[-1] + reach)[cuts])
        limits = edge + sign * np.append(0.0, ends)
        strips += [(min(pair), max(pair)) for pair in zip(limits[:-1].tolist(), limits[1:].tolist(), strict=True)]
    return strips
