"""Catalogue sources that are wide: circular Gaussians on the sky, with the beam and the fringes over them.

With delta the place in the plane that touches the sky at the centre, q the baseline's part in that plane and w that
towards the centre, in wavelengths, and sigma the dispersion, a direction's phase is 2 pi (w + q.delta - w delta^2 / 2),
as the sky is curved. The beam is B + g.delta + delta.H.delta / 2. So of the point's fringe there is left

    G [B + v (2 pi i q.g + tr H / 2) - 2 pi^2 v^2 q.H.q],    G = exp(-2 pi^2 v q^2) / c,    v = sigma^2 / c

with c = 1 + 2 pi i w sigma^2. For a source of a degree in the main lobe of a 14 m dish the slope's part is a sixth of B
on a baseline of 100 m at 150 MHz.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.point_sources import in_degrees, in_radians
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux, find
from hydrabeam_mpi.model.sky import Sky

VARIANCE = np.deg2rad(1 / 60) ** 2 / (8 * np.log(2))
"""sigma^2 of a full width at half maximum of one arcmin."""
LARGEST_LN = np.log(1e3)
"""Of a visibility over that of a point, from where a fit may start but does not stay."""
STEP = 1e-3
"""rad, of second derivatives of beams: with it a table's 1e-10 and the beam's fourth derivatives matter as little."""


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
        """Return how the sources' visibilities change as they become wider; ``x`` is (n_params,)."""
        return Columns(self._seen_wide(block, x)[1], len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the sources have more than if they were points, (Ntimes, Nbls)."""
        return block.spread(np.sum(self._seen_wide(block, x)[0], axis=-1))

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

    def _seen_wide(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the sources have more than if they were points, and its derivatives by their squared widths.

        The result is (2, Ntimes, Ngroups, n), zero below the horizon.
        """
        sky, (ra, dec) = block.setup.sky, in_radians(self.sources)
        index, positions = find(sky, self.sources), block.positions.follow(Sky(ra, dec, np.ones((1, len(ra)))))
        out = np.zeros((2, len(block.times), len(block.groups), len(ra)), dtype=complex)
        for t, itime in enumerate(block.times.tolist()):
            every, flux = block.sources(itime), np.zeros(sky.Nsrc)
            flux[every.index] = every.flux_without(self.kind)
            which, za, az = positions.above_horizon(itime)
            sources = Sources(which, za, az, flux[index[which]], block.beam)
            point = block.engine.responses(sources.enu, sources.flux, block.freq)
            out[:, t][..., which] = point * _of_point(sources, block.vectors * (block.freq / C_M_PER_S), x[which])
        return out


def _of_point(sources: Sources, vectors: FloatArray, x: FloatArray) -> ComplexArray:
    """Return what is to be multiplied with the fringes of points, (2, Ngroups, Nsrc), as `_seen_wide`.

    ``vectors``, (Ngroups, 3), are in wavelengths; ``x``, (Nsrc,), are squared widths.
    """
    down, around = sources.tangents
    toward, one, two = vectors @ sources.enu, vectors @ down, vectors @ around
    beam, slope, curvature = _around(sources)
    bent = 1 + 2j * np.pi * toward * (VARIANCE * x)
    variance, square = VARIANCE * x / bent, one**2 + two**2
    exponent = -2 * np.pi**2 * variance * square
    fading = np.exp(np.where(exponent.real > LARGEST_LN, LARGEST_LN, exponent)) / bent
    first = 2j * np.pi * (one * slope[0] + two * slope[1]) + 0.5 * (curvature[0] + curvature[2])
    second = 2 * np.pi**2 * (one**2 * curvature[0] + 2 * one * two * curvature[1] + two**2 * curvature[2])
    seen = beam + variance * first - variance**2 * second
    fades = -(2j * np.pi * toward + 2 * np.pi**2 * square / bent) / bent
    return np.stack(
        [fading * seen - beam, fading * (fades * seen + (first - 2 * variance * second) / bent**2) * VARIANCE]
    )


def _around(sources: Sources) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the beam, (Nsrc,), its slopes, (2, Nsrc), and second derivatives, (3, Nsrc), along the tangents."""
    down, around = sources.tangents

    def at(one: int, two: int) -> FloatArray:
        return sources.beam_at(sources.enu + STEP * (one * down + two * around))

    here, low, high, left, right = sources.beam, at(-1, 0), at(1, 0), at(0, -1), at(0, 1)
    across = at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)
    slope = np.stack([high - low, right - left]) / (2 * STEP)
    return here, slope, np.stack([high - 2 * here + low, 0.25 * across, right - 2 * here + left]) / STEP**2
