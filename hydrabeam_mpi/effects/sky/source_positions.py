"""Catalogue sources that are not where the catalogue has them: each is seen where it is, and not at its place."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.point_sources import beside, in_radians, resolution, responses, with_slopes
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux, find

ARCMIN = np.deg2rad(1 / 60)


class SourcePositions(CatalogueFlux):
    """Offsets of single sources from their places in the catalogue, and the relative errors of their fluxes.

    Offsets are those on the plane tangent at the place, East and North on the sky, the same in all channels. What
    belongs elsewhere is fitted better with another flux, so that this is part of it; an error of the flux alone is a
    `CatalogueFlux`. No offset is larger than what the array resolves: that far away is another source.
    """

    kind = "source_positions"
    title = "places of catalogue sources"
    linear = False
    unphysical = "a flux below zero, or a place that the array tells from that of the source"
    most: ClassVar[int] = 200
    most_again: ClassVar[int] = 100
    """Half of them by what they explain and half by brightness; each more costs weighing three columns in all data."""
    laws: ClassVar = {}

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the relative error of its flux and offsets East and North of every source."""
        own = self.errors(setup, {"relative flux error": 0.1, "offset east": 1.0, "offset north": 1.0})
        return replace(own, units=("", "arcmin", "arcmin") * len(self.sources))

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray:
        """Return zero for the sources that are elsewhere, or of another flux, and one for all others, (Nsrc,)."""
        factor = np.ones(setup.sky.Nsrc)
        factor[find(setup.sky, self.sources)[_is_moved(x)]] = 0.0
        return factor[sources.index]

    def extra_sky(self, block: RowBlock, itime: int, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return those sources where they are that are not in their places, and up, each (Nsrc,)."""
        part, moved = x.reshape(-1, 3), _is_moved(x)
        index, za, az = block.follow(*(one[moved] for one in self._where(part))).above_horizon(itime)
        return za, az, (self._fluxes(block, itime) * (1 + part[:, 0]))[moved][index]

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the sources where they are, and central differences of these by offset; ``x`` is (n_params,)."""
        part = x.reshape(-1, 3)
        seen, slopes = with_slopes(block, lambda shift: self._where(part, shift))
        flux = np.array([self._fluxes(block, itime) for itime in block.times.tolist()]).reshape(len(block.times), -1)
        by_place = ARCMIN * (flux * (1 + part[:, 0]))[:, np.newaxis] * slopes
        values = np.stack([flux[:, np.newaxis] * seen, *by_place], axis=-1)
        return Columns(values.reshape(*seen.shape[:2], len(x)), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the sources where they are less what the catalogue makes of them, (Ntimes, Nbls)."""
        part = x.reshape(-1, 3)
        there, here = responses(block, *self._where(part)), responses(block, *in_radians(self.sources))
        flux = np.array([self._fluxes(block, itime) for itime in block.times.tolist()]).reshape(len(block.times), -1)
        return block.spread(np.einsum("tgs,ts->tg", there * (1 + part[:, 0]) - here, flux))

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse fluxes below zero and offsets beyond the array's resolution; see `Effect.beyond`."""
        beyond, furthest = super().beyond(setup, x, std), resolution(setup) / ARCMIN
        east, north = x[:, 1::3], x[:, 2::3]
        distance = np.hypot(east, north)
        error = np.hypot(east * std[:, 1::3], north * std[:, 2::3]) / np.where(distance > 0, distance, 1.0)
        away = sigmas(distance - furthest, error).max(axis=0)
        beyond[1::3], beyond[2::3] = away, away
        return beyond

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return the sources that may be where the catalogue has them, as errors of their fluxes alone.

        By the data's likelihood of an offset, a Gaussian, and the prior of one of which nothing is known but that the
        array does not resolve it: where that of none is larger.
        """
        found, largest = list[tuple[BoolArray, Effect, FloatArray]](), resolution(setup) / ARCMIN
        trials = CatalogueFlux().n_hypotheses(setup)
        for number, source in enumerate(self.sources):
            offset, sigma = (one[0, 3 * number + 1 : 3 * number + 3] for one in (x, std))
            if sigma.all() and np.sum((offset / sigma) ** 2) < 2 * np.log(largest**2 / sigma.prod()):
                flux = CatalogueFlux([source], trials)
                found.append((np.arange(x.shape[1]) // 3 == number, flux, x[0, [3 * number]]))
        return found

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with every source, (n_hypotheses, 3) each, time by time."""
        return self.scan_columns(block, 3)

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Displace all by ``strength`` arcmin to some side; their fluxes are right, (n_params,)."""
        angle = rng.uniform(0, 2 * np.pi, len(self.sources))
        return strength * np.stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)], axis=1).ravel()

    def _where(self, part: FloatArray, shift: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return where the sources are, and ``shift`` radians east and north of there, (Nsources,) each."""
        return beside(*in_radians(self.sources), *(ARCMIN * part[:, 1:] + shift).T)

    def _fluxes(self, block: RowBlock, itime: int) -> FloatArray:
        """Return the sources' fluxes at a time, less what other effects take of those that are up, (Nsources,)."""
        sources, flux = block.sources(itime), block.setup.sky.flux[block.channel].copy()
        flux[sources.index] = sources.flux_without(self.kind)
        return flux[find(block.setup.sky, self.sources)]


def _is_moved(x: FloatArray) -> BoolArray:
    """Return which sources are not as the catalogue has them, (Nsources,): others look for their fluxes there."""
    return np.any(x.reshape(-1, 3) != 0, axis=1)
