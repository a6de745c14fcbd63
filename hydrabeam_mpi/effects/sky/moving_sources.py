"""Point sources that the sky model lacks and that move against the stars: the Moon, a planet, a balloon."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.grating_lobes import grating_lobes, seen_alike, turns_of_sky
from hydrabeam_mpi.effects.shared.point_sources import in_degrees, in_radians, keep_apart, on_tangent_plane, resolution
from hydrabeam_mpi.effects.shared.settings import Azimuth, Count, Elevation
from hydrabeam_mpi.effects.sky.missing_sources import AT_MOST, MissingSources, candidates, spacing

WAYS = np.array([[0, 0], *([i, j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j)], dtype=float)
"""Rates east and north at which a source is looked for, in resolutions in half of the time. A fit moves on from there:
what moves by three resolutions in all is at no time more than half of one from the nearest."""
MOST_PLACES = 16
"""Where candidates are looked at with all ways to move: what moves is smeared, and may not be best where it stays. In
the paper's case that takes a tenth of the time in which all effects are weighed."""
AHEAD = 1e-3
"""Hours in which a source moves so little that a plane is a sphere."""


class MovingSources(MissingSources):
    """Sources at unknown places that drift: missing sources whose places change at steady rates, east and north.

    A place is that in the middle of the time over which a source moves so. They are looked for where a source that
    stays would be, there with all `WAYS` to move. A source is fitted relative to the place and the rates where it was
    found.

    Parameters
    ----------
    sources, trials
        As of `MissingSources`.
    rates : sequence of (float, float), optional
        Of each source, degrees an hour east and north, from which the parameters count; zero by default.
    span : (float, float), optional
        First and last time (JD) at which they move so; those of the data by default.
    """

    kind = "moving_sources"
    title = "missing point sources that move"
    laws: ClassVar = {}

    def __init__(
        self,
        sources: Sequence[tuple[Azimuth, Elevation]] = (),
        trials: Count = 1,
        rates: Sequence[Sequence[float]] = (),
        span: tuple[float, float] | None = None,
    ) -> None:
        super().__init__(sources, trials)
        if rates and len(rates) != len(self.sources):
            raise ValueError("a source each has its rates")
        self.rates = np.reshape(rates, (-1, 2)).astype(float) if rates else np.zeros((len(self.sources), 2))
        self.span = span

    @property
    def special_case(self) -> tuple[str, str]:
        """Sources that stay where they are."""
        return MissingSources.kind, MissingSources.law

    @property
    def scanned_as(self) -> ScannedEffect:
        """Sources that stay where they are."""
        return MissingSources()

    def describe(self) -> dict[str, Any]:
        """Return which sources, from how many they were picked, how they move, and when they do so."""
        span = None if self.span is None else list(self.span)
        return {**super().describe(), "rates": self.rates.tolist(), "span": span}

    def in_full(self, setup: ObservingSetup) -> MovingSources:
        """Return the effect over the times of the data."""
        return MovingSources(self.sources, self.trials, self.rates.tolist(), self._span(setup))

    def some(self, which: IntArray) -> MovingSources:
        """Return the effect of some of its sources, (Nleft,), as they move."""
        sources = [self.sources[n] for n in which.tolist()]
        return MovingSources(sources, self.trials, self.rates[which].tolist(), self.span)

    def expanded(self, setup: ObservingSetup, hypotheses: IntArray) -> IntArray:
        """Return candidates that stay and that move, (Nall,), at those of these places that are a resolution apart."""
        ra, dec = candidates(setup)
        apart = hypotheses[keep_apart(ra[hypotheses], dec[hypotheses], resolution(setup), MOST_PLACES)]
        return (apart + len(ra) * np.arange(len(WAYS))[:, np.newaxis]).ravel()

    def every(self, setup: ObservingSetup, hypotheses: IntArray) -> MovingSources:
        """Take all of these candidates; ``hypotheses`` is (Nchosen,)."""
        ra, dec = candidates(setup)
        way, which = np.divmod(hypotheses, len(ra))
        rates = WAYS[way] * 2 * self._rate(setup)
        return MovingSources(in_degrees(ra[which], dec[which]), 1, rates.tolist(), self._span(setup))

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> MovingSources:
        """Place sources at these points, the best first, leaving out those within a resolution of better ones."""
        every = self.every(setup, hypotheses)
        kept = every.some(keep_apart(*in_radians(every.sources), resolution(setup), AT_MOST))
        kept.trials = len(WAYS) * MissingSources().at(setup, hypotheses[:1] % self.n_hypotheses(setup)).trials
        return kept

    def alike(self, setup: ObservingSetup, x: FloatArray, element: int) -> Iterator[MovingSources]:
        """Return the effect with one of its sources in the grating lobes of where it is, the highest ones first.

        What stays against the stars is told from its lobes, which do not; what moves may be in any of them, and a scan
        that knows few ways to move does not say in which.
        """
        lobes, part = grating_lobes(setup), x[0].reshape(len(self.sources), -1)
        if not len(lobes):
            return
        by_time = setup.times[np.argsort(setup.observation.times[setup.times])]
        itimes = by_time[[0, len(by_time) // 2, -1]]
        own = [np.stack(self._places(self._at_time(setup, part, itime)))[:, element] for itime in itimes]
        found = [seen_alike(turn, at, lobes) for turn, at in zip(turns_of_sky(setup, itimes), own, strict=True)]
        tracks, za = np.stack([places for places, _ in found], axis=1), found[1][1]
        for track in tracks[np.argsort(za)]:
            if np.all(np.isfinite(track)):
                yield self._along(element, track, self._hours(setup)[itimes])

    def _along(self, element: int, track: FloatArray, hours: FloatArray) -> MovingSources:
        """Return the effect with a source that goes from the first of three places to the last, (3, 2) radians."""
        east, north = np.rad2deg(on_tangent_plane(*track.T, *track[1]))
        sources, rates = list(self.sources), self.rates.copy()
        sources[element] = in_degrees(*track[1:2].T)[0]
        rates[element] = np.array([east[2] - east[0], north[2] - north[0]]) / max(hours[2] - hours[0], 1e-6)
        return MovingSources(sources, self.trials, rates.tolist(), self.span)

    def drawn(self, setup: ObservingSetup, rng: np.random.Generator) -> MovingSources:
        """Place a source at random, as `MissingSources.drawn`."""
        return super().drawn(setup, rng).in_full(setup)

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several times."""
        n_times = len(setup.fitted_jd)
        if n_times < 3:
            return f"what moves needs 3 fitted times or more; there are {n_times}"
        return super().not_applicable(setup)

    def carried_over(self, setup: ObservingSetup) -> MovingSources | str:
        """Return the sources where the data are of the same time: nobody knows where they are at others."""
        first, last = self._span(setup)
        if setup.jd[0] >= first and setup.jd[-1] <= last:
            return self
        return "is at unknown places at other times, as it moves against the stars"

    def refined(self, x: FloatArray, used: IntArray) -> tuple[MovingSources, FloatArray, IntArray]:
        """Return the sources in use where they have been found, with their rates east and north of there."""
        places, left, which = super().refined(x, used)
        if not len(which):
            return self.some(which), left, which
        part = left.reshape(len(x), len(places.sources), -1)
        kept, ahead = self.some(np.unique(used // part.shape[-1])), x[0, which].reshape(part.shape[1:]).copy()
        ahead[:, 1:3] += AHEAD * (kept.rates + ahead[:, 3:5])
        moved = on_tangent_plane(*kept._places(ahead), *in_radians(places.sources))
        part[..., 3:5] = 0.0
        rates = (np.rad2deg(moved) / AHEAD).T.tolist()
        return MovingSources(places.sources, self.trials, rates, self.span), part.reshape(left.shape), which

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return flux, right ascension, declination, rates and spectral index of every source, (Nfreqs, n_params)."""
        told = super().told(setup, x, std)
        refined, *_ = self.refined(x, np.arange(x.shape[1]))
        each = told.values.reshape(len(x), len(self.sources), -1)
        each[..., 3:5] = refined.rates
        return told

    def price_of_motion(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> float:
        """Return Occam's factor of the rates, of prior over posterior width, of all sources in use."""
        return float(np.sum(self._narrower(setup, std)))

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return the sources whose rates may be zero, as missing sources that stay where they are.

        By the data's likelihood of the rates, a Gaussian, and their prior: where it gains less than Occam's factor.
        """
        each, found = x.shape[1] // len(self.sources), list[tuple[BoolArray, Effect, FloatArray]]()
        narrower, sigma = self._narrower(setup, std), std[0].reshape(-1, each)[:, 3:5]
        rates = self.rates + x[0].reshape(-1, each)[:, 3:5]
        for number in np.flatnonzero(narrower):
            if np.sum((rates[number] / sigma[number]) ** 2) < 2 * narrower[number]:
                which = np.arange(x.shape[1]) // each == number
                stays = MissingSources([self.sources[number]], self.trials // len(WAYS))
                found.append((which, stays, np.delete(x[0, which], [3, 4])))
        return found

    def _narrower(self, setup: ObservingSetup, std: FloatArray) -> FloatArray:
        """Return how much narrower than their prior the rates of each source are told, nats; zero out of use."""
        sigma = std[0].reshape(len(self.sources), -1)[:, 3:5]
        prior = 3 * self._rate(setup)
        return np.log(prior / np.where(sigma > 0, np.minimum(sigma, prior), prior)).sum(axis=1)

    def _motion(self, setup: ObservingSetup) -> list[tuple[str, str, float, bool]]:
        """Return the rates east and north, by natural size one spacing of the candidates in half of the time."""
        rate = self._rate(setup)
        return [("motion east", "deg/h", rate, True), ("motion north", "deg/h", rate, True)]

    def _at_time(self, setup: ObservingSetup, part: FloatArray, itime: int) -> FloatArray:
        """Return the parameters of the sources, (Nsources, n_each), with the offsets that they have at a time."""
        moved = part.copy()
        moved[:, 1:3] += (self.rates + part[:, 3:5]) * self._hours(setup)[itime]
        return moved

    def _tracks(
        self, block: RowBlock, part: FloatArray, shift: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return where the sources are at all times, (Ntimes, Nsources) each."""
        places = [self._places(self._at_time(block.setup, part, itime), shift) for itime in block.times.tolist()]
        ra, dec = np.reshape(places, (len(places), 2, len(part))).transpose(1, 0, 2)
        return ra, dec

    def _add_motion(self, block: RowBlock, values: ComplexArray) -> None:
        """Fill in the derivatives by the rates: those by the place times how long ago the middle was."""
        hours = self._hours(block.setup)[block.times]
        values[..., 3:5] = values[..., 1:3] * hours[:, np.newaxis, np.newaxis, np.newaxis]

    def _span(self, setup: ObservingSetup) -> tuple[float, float]:
        return (float(setup.jd[0]), float(setup.jd[-1])) if self.span is None else self.span

    def _rate(self, setup: ObservingSetup) -> float:
        """Return the rate, deg/h, of one spacing of the candidates in half of the time."""
        first, last = self._span(setup)
        return float(np.rad2deg(spacing(setup))) / max(12 * (last - first), 1e-6)

    def _hours(self, setup: ObservingSetup) -> FloatArray:
        """Return the observation's times from the middle of those at which sources move so, hours, (Ntimes,)."""
        return np.asarray(24 * (setup.observation.times - np.mean(self._span(setup))))
