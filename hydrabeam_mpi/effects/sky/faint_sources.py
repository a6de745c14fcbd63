"""Faint sources that the sky model lacks, too many to be told one by one: fluxes at points all over what is seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpstrf

from hydrabeam_mpi.data.observation import C_M_PER_S, BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.point_sources import in_degrees, in_radians, place, resolution, responses, sampled
from hydrabeam_mpi.effects.shared.settings import Azimuth, Elevation
from hydrabeam_mpi.effects.sky.missing_sources import SPECTRAL_INDEX, MissingSources, candidates
from hydrabeam_mpi.model.positions import ManyDirections
from hydrabeam_mpi.model.sky import Sky, separation
from hydrabeam_mpi.random import generator

AT_FIRST = 100
"""They hold a fifth to a third of the power of a white sky as 37 to 19 antennas of 14 m see it in six hours, enough to
tell whether there is one; of many more each round would pay for the products."""
MORE = (250, 500, 1000, 2000)
"""How many there may be at once, as long as evidence rises: fewer than the data see make up for those that are left
out. Each is about twice the one before, up to what holds nearly all of the power (`MOST_POINTS`)."""
MOST_POINTS = 3000
"""Of the grid, those with the most power, from which points are taken: 99% of the power that 37 antennas see in six
hours is in 2,200 of them. The matrix of so many takes 72 MB."""
ROWS, TIMES = 600, 24
"""Visibilities by which they are chosen, and times that these are of: with 600 instead of 1,890 the fluxes of 37
antennas' first 400 points hold as much of a white sky's power (59.1% and 59.2%). In six hours 24 times are four degrees
apart, less than half the width of a dish's beam."""
LEAST_POWER = 1e-8
"""Of the first point's power, below which one is made up of those before it: a ten-thousandth of its visibilities, and
far above the rounding errors of the decomposition, 1e-13."""

MOST_SPOTS, LEAST_SPOT = 6, 0.2
"""Bright sources that all of it may be at most, as many as are looked at of any sort in a round; a spot with less than
this part of the brightest one's flux is not looked at, as far sidelobes have as much."""


class FaintSources(Effect):
    """Point sources on a grid, all with one prior: the shot noise of a population that a catalogue ends above.

    A catalogue ends at some flux, and what it lacks is too faint and too much to be found source by source. On the sky
    that is white noise: any two points are independent. An array sees it as well as it is sampled, so points are taken
    from a grid of half a resolution, first the one that would be seen with the most power, w |s|^2 over the
    visibilities s by the model beam, then each time the one with the most power that those before cannot make up for
    (Cholesky decomposition with pivots). Fluxes may have either sign, as they count from the population's mean, to
    which an interferometer is all but blind. They go with nu^-0.7.

    Parameters
    ----------
    sources : sequence of (float, float), optional
        Right ascension and declination, degrees; by default those that the data see best.
    n_sources : int
        How many those are.
    n_before : int
        How many come before them, which others have.
    """

    kind = "faint_sources"
    title = "faint sources that the catalogue lacks"
    linear = True
    changes_sky = True
    comes_in_parts = True
    shared = True
    of_the_sky = True

    def __init__(
        self,
        sources: Sequence[tuple[Azimuth, Elevation]] = (),
        n_sources: Annotated[int, Field(ge=1)] = AT_FIRST,
        n_before: Annotated[int, Field(ge=0)] = 0,
    ) -> None:
        self.sources = tuple((float(ra), float(dec)) for ra, dec in sources)
        self.n_sources = len(self.sources) or n_sources
        self.n_before = n_before

    def describe(self) -> dict[str, Any]:
        """Return where they are, or how many are taken, and how many come before."""
        which = {"sources": [list(one) for one in self.sources]} if self.sources else {"n_sources": self.n_sources}
        return {**which, "n_before": self.n_before}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for a point that is above the horizon."""
        return None if len(candidates(setup)[0]) else "nothing of the sky rises by 5 degrees at the times in use"

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the flux at every point; all have the same prior."""
        names = [f"flux towards {place(*one)}" for one in self._at(setup)]
        return Parameters.of(names, "Jy", 1.0)

    def sought_in(self, setup: ObservingSetup) -> FaintSources:
        """Return those that the data see best, by their places."""
        return self if self.sources else FaintSources(self._at(setup), n_before=self.n_before)

    def larger(self, setup: ObservingSetup) -> list[FaintSources]:
        """Return it with more points."""
        found = [self]
        for n_sources in MORE:
            more = _chosen(setup, self.n_before, n_sources)
            if len(more) > found[-1].n_sources:
                found.append(FaintSources(more, n_before=self.n_before))
        return found[1:]

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return all of it as the brightest spots of it, which may be sources with a place each.

        Where the catalogue lacks few sources that make up most of the data these points stand for them, too.
        """
        at, spots, fluxes = self._at(setup), list[tuple[float, float]](), list[float]()
        ra, dec = in_radians(at)
        left = np.where(np.any(std > 0, axis=0), x.mean(axis=0), 0.0)
        while len(spots) < MOST_SPOTS and left.any():
            brightest = int(np.argmax(left))
            mine = separation(ra, dec, ra[brightest], dec[brightest]) < resolution(setup)
            total, left = float(left[mine].sum()), np.where(mine, 0.0, left)
            if total < LEAST_SPOT * max(fluxes, default=0.0):
                break
            if total > 0:
                spots.append(at[brightest])
                fluxes.append(total)
        sources = MissingSources(spots, len(candidates(setup)[0]))
        parameters = sources.parameters(setup)
        begun = np.where(parameters.nonlinear, 0.0, np.array(fluxes)[parameters.element])
        return [(np.ones(x.shape[1], dtype=bool), sources, begun)] if spots else []

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the points after those that the model got last, as far as there are any."""
        if not isinstance(newest, FaintSources):
            return self
        n_before = newest.n_before + newest.n_sources
        following = _chosen(setup, n_before, AT_FIRST)
        return FaintSources(following, n_before=n_before) if following else self

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the visibilities of sources of 1 Jy at every point; ``x`` is (n_params,)."""
        values = responses(block, *in_radians(self._at(block.setup))) * _spectrum(block)
        return Columns(values, len(x), by_group=True)

    def extra_sky(self, block: RowBlock, itime: int, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the points that are up, each (Nsrc,)."""
        index, za, az = block.follow(*in_radians(self._at(block.setup))).above_horizon(itime)
        return za, az, _spectrum(block) * x[index]

    def _at(self, setup: ObservingSetup) -> Sequence[tuple[float, float]]:
        """Return the points, right ascension and declination in degrees."""
        return self.sources or _chosen(setup, self.n_before, self.n_sources)


def _spectrum(block: RowBlock) -> float:
    return float((block.freq / block.setup.reference_freq) ** SPECTRAL_INDEX)


def _chosen(setup: ObservingSetup, n_before: int, n: int) -> tuple[tuple[float, float], ...]:
    """Return up to ``n`` points after the first ``n_before``."""
    key = (FaintSources.kind,)
    if key not in setup.kept:
        ra, dec = candidates(setup)
        which = _in_order(*_as_seen(setup))
        setup.kept[key] = in_degrees(ra[which], dec[which])
    every: tuple[tuple[float, float], ...] = setup.kept[key]
    return every[n_before : n_before + n]


def _in_order(seen: FloatArray, points: IntArray) -> IntArray:
    """Return the points, the best first, as many as can be told apart, (Nchosen,); arguments are of `_as_seen`."""
    power = dsyrk(1.0, seen.T, lower=1)
    _, order, rank, _ = dpstrf(power, lower=1, tol=LEAST_POWER * float(power.diagonal().max()), overwrite_a=1)
    return points[order[:rank] - 1]


def _as_seen(setup: ObservingSetup) -> tuple[FloatArray, IntArray]:
    """Return real and imaginary parts of some visibilities of the candidates with the most power, and which these are.

    The former are (Nvis, Npoints), by the model beam at the middle channel, times the root of the number of baselines.
    """
    observation, channel = setup.observation, setup.observation.Nfreqs // 2
    beam = sampled(lambda za, az: setup.basis.synthesize(setup.prior_mean[channel], za, az))
    ra, dec = candidates(setup)
    sky = Sky(ra, dec, np.ones((observation.Nfreqs, len(ra))))
    every = ManyDirections(setup.positions(sky, observation), sky)
    times = setup.times[np.unique(np.linspace(0, len(setup.times) - 1, TIMES).round().astype(int))]
    above = []
    for itime in times.tolist():
        index, directions = every.above_horizon(itime)
        above.append((index, directions, beam(directions)))
    power = np.zeros(len(ra))
    for index, _, seen in above:
        power[index] += seen**2
    points = np.sort(np.argsort(-power, kind="stable")[:MOST_POINTS])
    rng, wavenumber = generator(0, FaintSources.kind), 2 * np.pi * observation.freqs[channel] / C_M_PER_S
    n_members = np.bincount(setup.redundant.group, minlength=setup.redundant.Ngroups)
    n_groups = min(setup.redundant.Ngroups, ROWS // len(times))
    rows = np.zeros((2, len(times), n_groups, len(points)))
    for (real, imaginary), (index, directions, seen) in zip(rows.swapaxes(0, 1), above, strict=True):
        groups = rng.permutation(setup.redundant.Ngroups)[:n_groups]
        _, here, there = np.intersect1d(index, points, assume_unique=True, return_indices=True)
        phases = wavenumber * setup.redundant.vectors[groups] @ directions[:, here]
        amplitude = np.sqrt(n_members[groups])[:, np.newaxis] * seen[here]
        real[:, there], imaginary[:, there] = amplitude * np.cos(phases), amplitude * np.sin(phases)
    return rows.reshape(-1, len(points)), points
