"""Catalogue sources that are wide: circular Gaussians on the sky; see `effects.shared.wide_sources`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.point_sources import in_radians
from hydrabeam_mpi.effects.shared.wide_sources import Symmetric, of_point
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux, find
from hydrabeam_mpi.model.sky import Sky

VARIANCE = np.deg2rad(1 / 60) ** 2 / (8 * np.log(2))
"""sigma^2 of a full width at half maximum of one arcmin."""


class ResolvedSource(CatalogueFlux):
    """Widths of single sources, the same in all channels; fluxes stay as they are.

    The parameter is the square of the full width at half maximum, of which a visibility's logarithm is a multiple.
    """

    kind = "resolved_source"
    title = "catalogue sources that are resolved"
    linear = False
    changes_sky = False
    gets_simpler_when_fitted = False
    unphysical = "a width whose square is below zero"
    most: ClassVar = 200
    laws: ClassVar = {}
    n_each: ClassVar[int] = 1
    """Parameters of a source."""
    _of_model: tuple[tuple[float, float], ...] = ()

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the same without the sources that the model has with widths: those are fitted there."""
        if not isinstance(newest, ResolvedSource) or not newest.sources:
            return self
        following = type(self)(self.sources, self.trials)
        following._of_model = (*self._of_model, *newest.sources)
        return following

    def brightest(self, setup: ObservingSetup) -> IntArray:
        """Return the sources that are looked at, ascending, (n_hypotheses,)."""
        brightest = super().brightest(setup)
        return brightest[~np.isin(brightest, find(setup.sky, self._of_model))]

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of sources that are looked at."""
        return len(self.brightest(setup))

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the squared width of every source."""
        own = self.errors(setup, {"squared width (FWHM)": 100.0})
        return replace(own, units=("arcmin2",) * len(own))

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return the widths themselves, which are no multiple of their errors: their squares are."""
        width = np.sqrt(np.maximum(x, 0.0))
        error = np.divide(std, 2 * width, out=np.sqrt(std), where=width > 0)
        names = tuple(name.replace("squared width", "width") for name in self.parameters(setup).names)
        return Told(names, ("arcmin",) * len(names), width, error, np.zeros(len(names), dtype=bool))

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray:
        """Return ones, as fluxes stay, (Nsrc,)."""
        return np.ones(len(sources.za))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return how the sources' visibilities change with their widths; ``x`` is (n_params,)."""
        seen = np.moveaxis(self._seen_wide(block, x)[1:], 0, -1)
        return Columns(seen.reshape(*seen.shape[:2], len(x)), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the sources have more than if they were points, (Ntimes, Nbls)."""
        return block.spread(np.sum(self._seen_wide(block, x)[0], axis=-1))

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse what is narrower than a point; see `Effect.beyond`."""
        return self._fluxes_below_zero(0.0, x, std)

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with every source, each (n_hypotheses, p), time by time."""
        return self.scan_columns(block, self.n_each)

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Make all as wide, (n_params,)."""
        return strength * self.parameters(setup).scale

    def shapes(self, north: FloatArray) -> Sequence[Symmetric]:
        """Return what the covariance of sources changes by with each of their parameters, arcmin^2 (FWHM).

        ``north``, (2, Nsrc), is the direction of celestial north along the tangents.
        """
        one = np.ones(north.shape[1])
        return [(one, 0 * one, one)]

    def _seen_wide(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the sources have more than if they were points, and its derivatives by each parameter of theirs.

        The result is (1 + n_each, Ntimes, Ngroups, n), zero below the horizon.
        """
        sky, (ra, dec) = block.setup.sky, in_radians(self.sources)
        index, positions = find(sky, self.sources), block.positions.follow(Sky(ra, dec, np.ones((1, len(ra)))))
        out = np.zeros((1 + self.n_each, len(block.times), len(block.groups), len(ra)), dtype=complex)
        for t, itime in enumerate(block.times.tolist()):
            every, flux = block.sources(itime), np.zeros(sky.Nsrc)
            flux[every.index] = every.flux_without(self.kind)
            which, za, az = positions.above_horizon(itime)
            sources = Sources(which, za, az, flux[index[which]], block.beam)
            # (n_each, 3, Nsrc)
            changes = VARIANCE * np.array(self.shapes(north_of(sources, block.setup.observation.latitude)))
            spread = np.sum(x.reshape(len(ra), self.n_each)[which].T[:, np.newaxis] * changes, axis=0)
            point = block.engine.responses(sources.enu, sources.flux, block.freq)
            out[:, t][..., which] = point * of_point(sources, block.vectors * (block.freq / C_M_PER_S), spread, changes)
        return out


def north_of(sources: Sources, latitude: float) -> FloatArray:
    """Return the unit vector towards the celestial pole along `Sources.tangents`, (2, Nsrc); East is [n1, -n0].

    The pole is that of date, which is within a few arcmin of that of the catalogue.
    """
    pole = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    parts = np.stack([pole @ tangent for tangent in sources.tangents])
    return np.asarray(parts / np.maximum(np.hypot(*parts), 1e-12))
