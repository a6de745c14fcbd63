"""Wrong spectra of catalogue sources: I(nu) is (1 + x) (nu/nu_0)^a I(nu), nu_0 the mean frequency of the channels."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux, find

STEEPEST = 3.0
"""Error of an index that no source has: they are between -2.5 (relics) and 0.5 (compact cores, or thermal)."""
LARGEST_LN = np.log(1e3)
"""Of a flux over that at the mean frequency, from where a fit may start but does not stay."""


class SpectralIndex(CatalogueFlux):
    """Errors of single sources' spectral indices, with the relative error of their flux at the mean frequency.

    A flux alone that is wrong alike in all channels is one number less, and a `CatalogueFlux`.
    """

    kind = "spectral_index"
    title = "spectral indices of catalogue sources"
    unphysical = "a flux below zero or an index that no source has"
    laws: ClassVar = {}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several channels."""
        if len(np.unique(setup.observation.freqs)) < 2:
            return "a spectral index needs several channels; with one it is a flux"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return both errors of every source."""
        return self.errors(setup, {"relative flux error": 0.1, "error of the spectral index": 0.5})

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse fluxes below zero and indices that no source has; see `Effect.beyond`."""
        too_steep = sigmas(np.abs(x[:, 1::2]) - STEEPEST, std[:, 1::2]).max(axis=0)
        return super().beyond(setup, x, std) + np.stack([np.zeros_like(too_steep), too_steep], axis=1).ravel()

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray:
        """Return what those sources that are in error have more or less, and one for the others, (Nsrc,)."""
        factor = np.ones(setup.sky.Nsrc)
        np.add.at(factor, find(setup.sky, self.sources), _factors(setup, sources.freq, x)[0] - 1)
        return factor[sources.index]

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the sources' visibilities, and how these grow with the index; ``x`` is (n_params,)."""
        values = self.seen(block)[..., np.newaxis] * _factors(block.setup, block.freq, x)[1]
        return Columns(values.reshape(*values.shape[:2], len(x)), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the sources have more, (Ntimes, Nbls)."""
        return block.spread(self.seen(block) @ (_factors(block.setup, block.freq, x)[0] - 1))

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with every source, each (n_hypotheses, p)."""
        projection, power = super().scan(block)
        slopes = _factors(block.setup, block.freq, np.zeros(2))[1]
        return projection * slopes, power * slopes**2


def _factors(setup: ObservingSetup, freq: float, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (1 + x) (nu/nu_0)^a of every source, (n,), and its derivatives by x and a, (n, 2)."""
    flux, index = x.reshape(-1, 2).T
    ratio = freq / setup.reference_freq
    power = np.exp(np.clip(index * np.log(ratio), -LARGEST_LN, LARGEST_LN))
    factor = (1 + flux) * power
    return factor, np.stack([power, factor * np.log(ratio)], axis=1)
