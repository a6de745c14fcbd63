"""Point sources that the sky model lacks: V gets 1/2 S(nu) B(s) exp(2 pi i nu b.s/c) more, fixed on the sky."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.point_sources import (
    beside,
    dirty_map,
    in_degrees,
    in_radians,
    keep_apart,
    on_tangent_plane,
    place,
    resolution,
    responses,
    with_slopes,
)
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.varying_sources import MayVary
from hydrabeam_mpi.model.sky import Sky, separation

SPECTRAL_INDEX = -0.7  # of a source of which nothing is known
SPACING = 0.5  # of candidates, in resolutions
MIN_SPACING = np.deg2rad(0.45)  # where an array resolves more, the search has to make do
MIN_ALTITUDE = np.deg2rad(5.0)  # that a candidate must reach
HIGH = np.deg2rad(60.0)  # where sources are placed to simulate with
AT_MOST = 20
BRIGHTEST = 10  # sources that tell a catalogue's counts, to a third of N
MIN_TRIALS = 10


class MissingSources(MayVary):
    """Sources at unknown places, each with a flux, a position and, given several channels, a spectral index.

    Candidates lie on a grid in the sky's own frame. A source is fitted relative to the point where it was found: a flux
    at the mean frequency, an offset on the plane tangent there, and the departure of its spectral index from -0.7. What
    is told is where it is, right ascension and declination in the frame of the catalogue (ICRS); once a fit has ended
    it is also described from there.

    Parameters
    ----------
    sources : sequence of (float, float)
        Right ascension and declination, degrees, from which offsets count.
    trials : int
        Number of independent directions from which these were picked.
    """

    kind = "missing_sources"
    title = "missing point sources"
    laws: ClassVar = {
        "smooth": "missing point sources that vary",
        "nightly": "missing point sources that vary anew each night",
    }

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return flux, offsets east and north, and the change of spectral index of every source."""
        apart = float(np.rad2deg(spacing(setup)))
        each = [
            ("flux", "Jy", 1.0, False),
            ("offset east", "deg", apart, True),
            ("offset north", "deg", apart, True),
            *self._motion(setup),
            ("change of spectral index", "", 0.5, True),
        ][: self._n_each(setup)]
        rows = [(f"source at {place(*source)}: {what}", *rest) for source in self.sources for what, *rest in each]
        names, units, scale, nonlinear = zip(*rows, strict=True) if rows else ((), (), (), ())
        element = np.repeat(np.arange(len(self.sources)), len(each))
        trials = max(self.trials, len(self.sources)) if rows else 0
        made = Parameters.of(names, units, np.array(scale, dtype=float), element, nonlinear, trials)
        return replace(made, rare_above=brightest_expected(setup.sky))

    def refined(self, x: FloatArray, used: IntArray) -> tuple[Self, FloatArray, IntArray]:
        """Return the sources in use where they have been found, with no offsets left, (Nfreqs, n_left)."""
        if not len(used):
            return self.some(used), x[:, :0], used
        each = x.shape[1] // len(self.sources)
        left = np.flatnonzero(np.isin(np.arange(x.shape[1]) // each, used // each))
        part = x[:, left].reshape(len(x), -1, each)
        kept = self.some(np.unique(used // each))
        sources = in_degrees(*kept._places(part[0]))
        part[..., 1:3] = 0.0
        return self.of([(ra % 360, dec) for ra, dec in sources], self.trials), part.reshape(len(x), -1), left

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse fluxes below zero; see `Effect.beyond`."""
        return self._fluxes_below_zero(0.0, x, std)

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return the sources whose place a catalogue source may have, as errors of the fluxes of these.

        By the data's likelihood of a place, a Gaussian, and the prior of a place that nothing is known of: where that
        of the likeliest catalogue source is larger.
        """
        sky, each = setup.sky, x.shape[1] // len(self.sources)
        scale, found = 3 * spacing(setup), list[tuple[BoolArray, Effect, FloatArray]]()
        for number, (ra, dec) in enumerate(zip(*self._places(x[0].reshape(-1, each)), strict=True)):
            sigma = np.deg2rad(std[0, each * number + 1 : each * number + 3])
            near = np.flatnonzero(separation(sky.ra, sky.dec, ra, dec) < scale)
            if not sigma.all() or not len(near):
                continue
            east, north = on_tangent_plane(sky.ra[near], sky.dec[near], ra, dec)
            distance = (east / sigma[0]) ** 2 + (north / sigma[1]) ** 2
            best = near[[np.argmin(distance)]]
            if distance.min() < 2 * np.log(scale**2 / sigma.prod()):
                flux = CatalogueFlux(in_degrees(sky.ra[best], sky.dec[best]), CatalogueFlux().n_hypotheses(setup))
                error = x[0, each * number] / sky.flux[:, best].mean(axis=0)
                found.append((np.arange(x.shape[1]) // each == number, flux, error))
        return found

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return flux, right ascension, declination and spectral index of every source, (Nfreqs, n_params)."""
        motion = [(what, unit) for what, unit, *_ in self._motion(setup)]
        where = [("right ascension", "deg"), ("declination", "deg"), *motion]
        each, units = zip(("flux", "Jy"), *where, ("spectral index", ""), strict=True)
        refined, left, _ = self.refined(x, np.arange(x.shape[1]))
        values, errors = (part.reshape(len(x), len(self.sources), -1).copy() for part in (left, std))
        n = values.shape[2]
        for number, (ra, dec) in enumerate(refined.sources):
            values[:, number, 1:3] = ra, dec
            errors[:, number, 1] /= np.cos(np.deg2rad(dec))
        values[..., 1 + len(where) :] += SPECTRAL_INDEX
        names = tuple(f"source at {place(*source)}: {what}" for source in refined.sources for what in each[:n])
        from_zero = np.tile(np.arange(n) == 0, len(self.sources))
        return Told(names, units[:n] * len(self.sources), values.reshape(x.shape), errors.reshape(x.shape), from_zero)

    def extra_sky(self, block: RowBlock, itime: int, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sources that are up, each (Nsrc,)."""
        part = x.reshape(-1, self._n_each(block.setup))
        flux = part[:, 0] * _spectrum(part, block)
        index, za, az = block.follow(*self._places(self._at_time(block.setup, part, itime))).above_horizon(itime)
        return za, az, flux[index]

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return derivatives: the source itself, its central difference by position, and its growth with ln nu.

        ``x`` is (n_params,).
        """
        each = self._n_each(block.setup)
        part = x.reshape(-1, each)
        slopes: ComplexArray | None = None
        if part[:, 0].any():
            seen, slopes = with_slopes(block, lambda shift: self._tracks(block, part, shift))
        else:  # Without a flux nothing depends on where a source is.
            seen = responses(block, *self._tracks(block, part))
        values = np.zeros((*seen.shape, each), dtype=complex)
        values[..., 0] = seen
        if slopes is not None:
            values[..., 1:3] = np.moveaxis(np.deg2rad(part[:, 0]) * slopes, 0, -1)
        self._add_motion(block, values)
        if _has_index(block.setup):
            values[..., -1] = part[:, 0] * np.log(block.freq / block.setup.reference_freq) * seen
        values *= _spectrum(part, block)[:, np.newaxis]
        return Columns(values.reshape(*seen.shape[:2], len(x)), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the sources' visibilities, (Ntimes, Nbls)."""
        part = x.reshape(-1, self._n_each(block.setup))
        return block.spread(self.seen(block, x) @ part[:, 0])

    def seen(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return their visibilities had they 1 Jy at the mean frequency, (Ntimes, Ngroups, Nsources)."""
        part = x.reshape(-1, self._n_each(block.setup))
        return responses(block, *self._tracks(block, part)) * _spectrum(part, block)

    def _motion(self, setup: ObservingSetup) -> list[tuple[str, str, float, bool]]:
        """Return name, unit and natural size of what tells how a source moves, and that it is nonlinear; none here."""
        return []

    def _at_time(self, setup: ObservingSetup, part: FloatArray, itime: int) -> FloatArray:
        """Return the parameters of the sources, (Nsources, n_each), with the offsets that they have at a time."""
        return part

    def _tracks(
        self, block: RowBlock, part: FloatArray, shift: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return where the sources are at all times, (Nsources,) each, or (Ntimes, Nsources) where they move."""
        return self._places(part, shift)

    def _add_motion(self, block: RowBlock, values: ComplexArray) -> None:
        """Fill in the derivatives by how a source moves, once those by its place are there."""

    def _places(self, part: FloatArray, shift: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return where the sources are, and ``shift`` radians east and north of there, (Nsources,) each."""
        return beside(*in_radians(self.sources), *(np.deg2rad(part[:, 1:3]) + shift).T)

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of grid points that rise high enough."""
        return len(candidates(setup)[0])

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with a source at every grid point, each (n_hypotheses, p)."""
        return self.scan_in_time(block, np.ones((len(block.times), 1)))

    def scan_in_time(self, block: RowBlock, functions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Do so with all functions, (Ntimes, k), in one pass, each (n_hypotheses, k)."""
        ra, dec = candidates(block.setup)
        spectrum = (block.setup.observation.freqs / block.setup.reference_freq) ** SPECTRAL_INDEX
        sky = Sky(ra, dec, np.broadcast_to(spectrum[:, np.newaxis], (len(spectrum), len(ra))))
        return dirty_map(block, sky, functions)

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        """Place sources at these points, the best first, leaving out those within a resolution of better ones.

        ``hypotheses`` is (Nchosen,).
        """
        ra, dec = candidates(setup)
        trials = max(MIN_TRIALS, round(len(ra) * (spacing(setup) / resolution(setup)) ** 2))
        ra, dec = ra[hypotheses], dec[hypotheses]
        kept = keep_apart(ra, dec, resolution(setup), AT_MOST)
        return self.of(in_degrees(ra[kept], dec[kept]), trials)

    def drawn(self, setup: ObservingSetup, rng: np.random.Generator) -> Self:
        """Place a source at random where it comes within 30 degrees of the zenith."""
        ra, dec = candidates(setup, HIGH)
        chosen = rng.integers(len(ra), size=1)
        return self.of(in_degrees(ra[chosen], dec[chosen]))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw offsets within half a grid spacing and spectral indices; every flux is ``strength`` Jy, (n_params,)."""
        parameters = self.parameters(setup)
        x = parameters.scale * rng.uniform(-0.5, 0.5, len(parameters))
        x[:: self._n_each(setup)] = strength
        return x

    def _n_each(self, setup: ObservingSetup) -> int:
        """Return the number of parameters of a source: one channel has no spectral index."""
        return 3 + len(self._motion(setup)) + _has_index(setup)


def brightest_expected(sky: Sky) -> float:
    """Return the flux above which one source is expected, Jy, by the counts of the brightest ones in the catalogue.

    Of counts N(> S) ~ S^-3/2 through the k-th brightest, at S_k, one is above k^2/3 S_k. What a catalogue lacks is of
    the same kind as what it has.
    """
    fluxes = np.sort(sky.flux.mean(axis=0))[::-1][:BRIGHTEST]
    return float(len(fluxes) ** (2 / 3) * fluxes[-1]) if len(fluxes) and fluxes[-1] > 0 else np.inf


def candidates(setup: ObservingSetup, altitude: float = MIN_ALTITUDE) -> tuple[FloatArray, FloatArray]:
    """Return right ascension and declination of the grid points that rise to ``altitude`` in the times in use.

    Each is (Npoints,), found once for a setup.
    """
    key = (MissingSources.kind, altitude)
    if key not in setup.kept:
        setup.kept[key] = _candidates(setup, altitude)
    found: tuple[FloatArray, FloatArray] = setup.kept[key]
    return found


def _candidates(setup: ObservingSetup, altitude: float) -> tuple[FloatArray, FloatArray]:
    ra, dec = _grid(spacing(setup))
    observation = setup.observation
    zenith = observation.latitude
    # Culmination alone rules many out, and leaves the fewer to be turned.
    can = np.abs(dec - zenith) <= np.pi / 2 - altitude
    ra, dec = ra[can], dec[can]
    nearest = np.full(len(ra), -1.0)
    for lst in observation.lsts[setup.times].tolist():
        np.maximum(nearest, np.cos(lst - ra), out=nearest)
    sine = np.sin(zenith) * np.sin(dec) + np.cos(zenith) * np.cos(dec) * nearest
    rises = sine >= np.sin(altitude)
    return ra[rises], dec[rises]


def spacing(setup: ObservingSetup) -> float:
    """Return the distance of neighbouring grid points, radians."""
    return max(SPACING * resolution(setup), MIN_SPACING)


def _grid(spacing: float) -> tuple[FloatArray, FloatArray]:
    """Return points all over the sphere on rings of equal declination, every other one turned by half a step."""
    n_rings = int(np.ceil(np.pi / spacing))
    dec = np.pi * ((np.arange(n_rings) + 0.5) / n_rings - 0.5)
    counts = np.ceil(2 * np.pi * np.cos(dec) / spacing).astype(int)
    ring = np.repeat(np.arange(n_rings), counts)
    along = np.arange(len(ring)) - (np.cumsum(counts) - counts)[ring]
    return 2 * np.pi * (along + 0.5 * (ring % 2)) / counts[ring], dec[ring]


def _has_index(setup: ObservingSetup) -> bool:
    """Whether sources have a spectral index: not with one channel."""
    return setup.observation.Nfreqs > 1


def _spectrum(part: FloatArray, block: RowBlock) -> FloatArray:
    """Return (nu / nu_0) to the sources' spectral indices, (Nsources,)."""
    index = SPECTRAL_INDEX + (part[:, -1] if _has_index(block.setup) else np.zeros(len(part)))
    return np.asarray((block.freq / block.setup.reference_freq) ** index)
