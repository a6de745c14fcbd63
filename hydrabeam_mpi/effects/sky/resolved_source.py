"""Catalogue sources that are wide: a circular Gaussian's visibilities are exp(-2 pi^2 sigma^2 |u|^2) those of a point.

|u| is the length of the baseline in wavelengths as seen from the source, sigma the dispersion. Over the source the beam
counts as the same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.point_sources import in_degrees, in_radians
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.model.engines.fringes import C_M_PER_S, enu
from hydrabeam_mpi.model.sky import Sky

FADING = (np.pi * np.deg2rad(1 / 60)) ** 2 / (4 * np.log(2))
"""2 pi^2 sigma^2 of a full width at half maximum of one arcmin."""
LARGEST_LN = np.log(1e3)
"""Of a visibility over that of a point, from where a fit may start but does not stay."""


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
        """Return what the sources lose as they become wider; ``x`` is (n_params,)."""
        fading = self._fading(block)
        return Columns(-self.seen(block) * fading * _fraction(fading, x), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the sources have less than if they were points, (Ntimes, Nbls)."""
        return block.spread(np.sum(self.seen(block) * (_fraction(self._fading(block), x) - 1), axis=-1))

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse what is narrower than a point; see `Effect.beyond`."""
        return self._fluxes_below_zero(0.0, x, std)

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with every source, each (n_hypotheses, 1), time by time."""
        sky = block.setup.sky.select(self.brightest(block.setup.sky))
        every, sums = type(self)(in_degrees(sky.ra, sky.dec)), np.zeros((2, sky.Nsrc))
        for t in range(len(block.times)):
            now = replace(block, times=block.times[t : t + 1])
            seen = block.spread(every.columns(now, np.zeros(sky.Nsrc)).values)[0]
            weights = block.weights[t]
            sums += ((weights * block.residual[t]) @ seen.conj()).real, weights @ np.abs(seen) ** 2
        return sums[0][:, np.newaxis], sums[1][:, np.newaxis]

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Make all as wide, (n_params,)."""
        return strength * self.parameters(setup).scale

    def _fading(self, block: RowBlock) -> FloatArray:
        """Return 2 pi^2 sigma^2 |u|^2 of a width of one arcmin, (Ntimes, Ngroups, n); zero below the horizon."""
        ra, dec = in_radians(self.sources)
        positions = block.positions.follow(Sky(ra, dec, np.ones((1, len(ra)))))
        vectors = block.vectors * (block.freq / C_M_PER_S)
        out = np.zeros((len(block.times), len(vectors), len(ra)))
        for t, itime in enumerate(block.times.tolist()):
            index, za, az = positions.above_horizon(itime)
            length = np.sum(vectors**2, axis=1)[:, np.newaxis] - np.square(vectors @ enu(za, az))
            out[t][:, index] = FADING * np.maximum(length, 0.0)
        return out


def _fraction(fading: FloatArray, x: FloatArray) -> FloatArray:
    """Return the visibilities over those of points, of one shape with ``fading``."""
    return np.exp(-np.maximum(fading * x, -LARGEST_LN))
