"""Wrong fluxes of catalogue sources: V gets x/2 I(nu) B(s) exp(2 pi i nu b.s/c) more, x being the relative error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar, Self

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.apparent import faintest_first
from hydrabeam_mpi.effects.shared.point_sources import (
    PointSources,
    dirty_map,
    in_degrees,
    in_radians,
    keep_apart,
    place,
    resolution,
    responses,
)
from hydrabeam_mpi.effects.shared.time_laws import MOST_ORDERS
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.positions import RotatedPositions
from hydrabeam_mpi.model.sky import Sky, separation

AT_MOST = 40
APART = 0.1  # resolutions between two sources that the data could tell apart
SAME = 1e-6  # rad, within which a direction is that of a catalogue source


class CatalogueFlux(PointSources):
    """Relative errors of single sources' fluxes, the same in all channels.

    Parameters
    ----------
    sources : sequence of (float, float)
        Right ascension and declination of catalogue sources, degrees.
    trials : int
        Number of sources from which these were picked.
    """

    kind = "catalogue_flux"
    title = "fluxes of catalogue sources"
    linear = True
    most: ClassVar[int] = 20_000
    """Sources that are looked at."""
    functions_in_time: ClassVar[int] = MOST_ORDERS
    """All: sources scintillate, some times an hour or faster, and few do at once."""
    laws: ClassVar = {
        "smooth": "catalogue sources that vary",
        "nightly": "catalogue sources that vary anew each night",
        "anew": "catalogue sources that scintillate",
    }

    def carried_over(self, setup: ObservingSetup) -> Self:
        """Return the errors of those of the sources that the catalogue has with which other data are modelled."""
        sky, places = setup.sky, zip(*in_radians(self.sources), strict=True)
        return self.some(np.flatnonzero([np.any(separation(sky.ra, sky.dec, *place) <= SAME) for place in places]))

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the relative error of every source's flux."""
        return self.errors(setup, {"relative flux error": 0.1})

    def errors(self, setup: ObservingSetup, each: Mapping[str, float]) -> Parameters:
        """Return parameters of every source, by name with their natural sizes."""
        n = len(self.sources)
        called = setup.sky.names or ("",) * setup.sky.Nsrc
        index = find(setup.sky, self.sources)
        names = [called[i] or f"source {place(*source)}" for i, source in zip(index, self.sources, strict=True)]
        names, scale = [f"{name}: {error}" for name in names for error in each], np.tile([*each.values()], n)
        return Parameters.of(
            names, "", scale, np.repeat(np.arange(n), len(each)), trials=max(self.trials, n) if n else 0
        )

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray:
        """Return one plus the relative error of those sources that are in error, (Nsrc,)."""
        factor = np.ones(setup.sky.Nsrc)
        np.add.at(factor, find(setup.sky, self.sources), x)
        return factor[sources.index]

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the sources' visibilities, less what other effects take of their fluxes; ``x`` is (n_params,)."""
        return Columns(self.seen(block), len(self.sources), by_group=True)

    def seen(self, block: RowBlock) -> ComplexArray:
        """Return the sources' visibilities, less what other effects take of their fluxes, (Ntimes, Ngroups, n)."""
        sky = block.setup.sky
        index = find(sky, self.sources)
        values = responses(block, sky.ra[index], sky.dec[index])
        for seen, itime in zip(values, block.times.tolist(), strict=True):
            sources, flux = block.sources(itime), np.zeros(sky.Nsrc)
            flux[sources.index] = sources.flux_without(self.kind)
            seen *= flux[index]
        return values

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse errors below -1, by which a flux would be below zero; see `Effect.beyond`."""
        return self._fluxes_below_zero(-1.0, x, std)

    def brightest(self, setup: ObservingSetup) -> IntArray:
        """Return the sources that are looked at, those that the array sees brightest, ascending, (n_hypotheses,)."""
        return np.sort(faintest_first(setup)[-self.most :])

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of sources that are looked at."""
        return min(setup.sky.Nsrc, self.most)

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with every source, each (n_hypotheses, p)."""
        return dirty_map(block, block.setup.sky.select(self.brightest(block.setup)))

    def scan_columns(self, block: RowBlock, n_each: int) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with the ``n_each`` columns of every source, time by time; (n_hypotheses, p) each."""
        sky = block.setup.sky.select(self.brightest(block.setup))
        every, at_zero = type(self)(in_degrees(sky.ra, sky.dec)), np.zeros(sky.Nsrc * n_each)
        sums = np.zeros((2, len(at_zero)))
        # What redundant baselines see is the same.
        residual, weights = block.summed(block.weights * block.residual), block.summed(block.weights)
        for t in range(len(block.times)):
            seen = every.columns(replace(block, times=block.times[t : t + 1]), at_zero).values[0]
            sums += (residual[t] @ seen.conj()).real, weights[t] @ np.abs(seen) ** 2
        scores, powers = sums.reshape(2, sky.Nsrc, n_each)
        return scores, powers

    def scan_in_time(self, block: RowBlock, functions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Do so with all functions, (Ntimes, k), in one pass, each (n_hypotheses, k)."""
        return dirty_map(block, block.setup.sky.select(self.brightest(block.setup)), functions)

    def every(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        """Take all of these sources; ``hypotheses`` is (Nchosen,)."""
        sky, index = setup.sky, self.brightest(setup)[hypotheses]
        return type(self)(in_degrees(sky.ra[index], sky.dec[index]), self.n_hypotheses(setup))

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        """Take these sources, the best first, leaving out those that better ones cannot be told from.

        ``hypotheses`` is (Nchosen,).
        """
        sky = setup.sky
        index = self.brightest(setup)[hypotheses]
        kept = index[keep_apart(sky.ra[index], sky.dec[index], APART * resolution(setup), AT_MOST)]
        return type(self)(in_degrees(sky.ra[kept], sky.dec[kept]), self.n_hypotheses(setup))

    def foremost(self, setup: ObservingSetup, n: int) -> Self:
        """Take the sources that the model beam sees brightest at any time, the brightest first."""
        sky = setup.sky.select(self.brightest(setup))
        positions = RotatedPositions(sky, setup.observation)
        seen = np.zeros(sky.Nsrc)
        for itime in setup.times.tolist():
            index, za, az = positions.above_horizon(itime)
            beam = np.asarray(setup.basis.synthesize(setup.prior_mean[0], za, az)).real
            seen[index] = np.maximum(seen[index], np.abs(beam * sky.flux[0, index]))
        chosen = np.argsort(-seen)[:n]
        return type(self)(in_degrees(sky.ra[chosen], sky.dec[chosen]))

    def drawn(self, setup: ObservingSetup, rng: np.random.Generator) -> Self:
        """Take one of the twenty sources that the model beam sees brightest at any time."""
        foremost = self.foremost(setup, 20).sources
        return type(self)([foremost[i] for i in rng.choice(len(foremost), size=1)])

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw errors of ``strength`` x scale, of either sign, (n_params,)."""
        scale = self.parameters(setup).scale
        return strength * scale * rng.choice([-1.0, 1.0], size=len(scale))


def find(sky: Sky, sources: Sequence[tuple[float, float]]) -> IntArray:
    """Return the index of the catalogue source at each direction (degrees), (N,).

    Raises
    ------
    InputError
        If there is none within 0.2 arcseconds.
    """
    return np.array(_find(sky, tuple(sources)), dtype=int)


@lru_cache(maxsize=1)
def _find(sky: Sky, sources: tuple[tuple[float, float], ...]) -> list[int]:
    index = []
    order = np.argsort(sky.dec)
    declinations = sky.dec[order]
    for ra, dec in zip(*in_radians(sources), strict=True):
        # Those on the same ring of declination, ascending: an angle to all sources would be most of the time of a scan.
        near = np.sort(order[slice(*np.searchsorted(declinations, [dec - 2 * SAME, dec + 2 * SAME]))])
        distance = separation(sky.ra[near], sky.dec[near], ra, dec)
        if not np.min(distance, initial=np.inf) <= SAME:
            raise InputError(
                f"the catalogue has no source at {place(*np.rad2deg([ra, dec]))}",
                field="catalogue_flux",
                remedy="use the catalogue and the flux cut with which the effect was found",
            )
        index.append(int(near[np.argmin(distance)]))
    return index
