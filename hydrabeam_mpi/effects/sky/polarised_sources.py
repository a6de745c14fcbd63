"""Linearly polarised catalogue sources: V gets 1/2 (Q cos 2 psi + U sin 2 psi) B(s) exp(2 pi i nu b.s/c) more.

psi is the position angle along which the feed receives at the source, see `effects.shared.feed_angle`. It turns with
the sky, and so a polarised source varies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, Self, get_args

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.apparent import faintest_first
from hydrabeam_mpi.effects.shared.feed_angle import FEEDS, Mount, twice_angle
from hydrabeam_mpi.effects.shared.point_sources import dirty_map, in_degrees, in_radians, resolution
from hydrabeam_mpi.effects.shared.settings import Azimuth, Count, Elevation
from hydrabeam_mpi.effects.sky.catalogue_flux import APART, AT_MOST, CatalogueFlux, find
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.sky import Sky, separation

LARGEST_ROTATION = 100.0
"""rad/m^2 of rotation measures that are looked for: away from the plane of the Galaxy hardly any is larger."""
MOST_ROTATIONS = 6
"""Rotation measures of one source that are weighed beside each other, as many as are fitted to find the best."""
MOST_CANDIDATES = 40_000
"""Sources times rotation measures times mounts that are looked at, of more the brightest sources: all are held."""


class PolarisedSources(CatalogueFlux):
    """Stokes Q and U of single sources over their fluxes and, given several channels, their rotation measures.

    Q + iU is (x_Q + i x_U) I exp(2 i RM (lambda^2 - lambda_0^2)), with the wavelength lambda_0 of one frequency. A
    rotation measure is fitted relative to the one with which the source was found.

    Parameters
    ----------
    sources : sequence of (float, float)
        Right ascension and declination of catalogue sources, degrees.
    trials : int
        Number of sources, rotation measures and mounts from which these were picked.
    rotation_measures : sequence of float
        rad/m^2, from which those of the sources count; all zero by default.
    mounts : sequence of {"fixed", "alt-az"}
        With which each source varies as it does; all fixed by default.
    freq : float, optional
        Hz, to which Q and U refer; the mean of all channels by default.
    """

    kind = "polarised_sources"
    title = "polarised catalogue sources"
    unphysical = "more than all of its flux polarised"
    most: ClassVar[int] = 2000
    """Sources that are looked at, the brightest ones: of faint ones a few per cent are nothing."""
    most_again: ClassVar[int] = 100
    """Half of them by what they explain and half by brightness; each more costs weighing two columns in all data."""
    laws: ClassVar = {}

    def __init__(
        self,
        sources: Sequence[tuple[Azimuth, Elevation]] = (),
        trials: Count = 1,
        rotation_measures: Sequence[float] = (),
        mounts: Sequence[Mount] = (),
        freq: float | None = None,
    ) -> None:
        super().__init__(sources, trials)
        self.rotation_measures = tuple(map(float, rotation_measures)) or (0.0,) * len(self.sources)
        fixed: Mount = "fixed"
        self.mounts = tuple(mounts) or (fixed,) * len(self.sources)
        if not len(self.sources) == len(self.rotation_measures) == len(self.mounts):
            raise ValueError("a rotation measure and a mount for each source")
        self.freq = freq

    def describe(self) -> dict[str, Any]:
        """Return which sources, from how many candidates, how they turn, and the frequency of Q and U."""
        turning = {"rotation_measures": list(self.rotation_measures), "mounts": list(self.mounts)}
        return {**super().describe(), **turning, **({} if self.freq is None else {"freq": self.freq})}

    def in_full(self, setup: ObservingSetup) -> Self:
        """Return the effect with the frequency to which Q and U refer."""
        freq = setup.reference_freq if self.freq is None else self.freq
        return type(self)(self.sources, self.trials, self.rotation_measures, self.mounts, freq)

    def some(self, which: IntArray) -> Self:
        """Return the effect of some of its sources, (Nleft,)."""
        chosen = which.tolist()
        rotation, mounts = ([self.rotation_measures[n] for n in chosen], [self.mounts[n] for n in chosen])
        return type(self)([self.sources[n] for n in chosen], self.trials, rotation, mounts, self.freq)

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for two equal linear feeds."""
        pol = setup.observation.pols[0]
        if pol[0] != pol[1] or pol[0] not in FEEDS:
            return f"'{pol}' is not of equal linear feeds, such as 'ee', which see what is polarised linearly"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return Q and U over I and, given several channels, the change of rotation measure of every source."""
        sizes = {"Q/I": 0.05, "U/I": 0.05, "change of rotation measure": rotation_step(setup)}
        each = dict(list(sizes.items())[: _n_each(setup)])
        own, is_rotation = self.errors(setup, each), np.arange(len(each)) == 2
        units = tuple("rad/m^2" if rotation else "" for rotation in is_rotation) * len(self.sources)
        by_mount = {"fixed": "", "alt-az": ", of feeds that turn with the parallactic angle"}
        names = tuple(f"{name}{by_mount[self.mounts[n]]}" for name, n in zip(own.names, own.element, strict=True))
        return replace(own, names=names, units=units, nonlinear=np.tile(is_rotation, len(self.sources)))

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return Q/I, U/I and rotation measures, (Nfreqs, n_params); of the last zero is as likely as any."""
        own, n = self.parameters(setup), _n_each(setup)
        names = tuple(name.replace("change of rotation", "rotation") for name in own.names)
        values = x.copy()
        if n == 3:
            values[:, 2::3] += self.rotation_measures
        return Told(names, own.units, values, std, ~own.nonlinear)

    def refined(self, x: FloatArray, used: IntArray) -> tuple[Self, FloatArray, IntArray]:
        """Return the sources in use with the rotation measures that they have been found to have."""
        each = x.shape[1] // max(len(self.sources), 1)
        if not len(used) or each < 3:
            return super().refined(x, used)  # type: ignore[return-value]
        chosen = np.unique(used // each)
        kept, left = self.some(chosen), (each * chosen[:, np.newaxis] + np.arange(each)).ravel()
        values = x[:, left].copy()
        kept.rotation_measures = tuple(np.add(kept.rotation_measures, values[0, 2::3]).tolist())
        values[:, 2::3] = 0.0
        return kept, values, left

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse more polarised flux than there is flux; see `Effect.beyond`."""
        each = _n_each(setup)
        (q, u), errors = (np.moveaxis(one.reshape(len(one), -1, each)[..., :2], 2, 0) for one in (x, std))
        return np.repeat(sigmas(np.hypot(q, u) - 1, np.hypot(*errors)).max(axis=0), each)

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray:
        """Return what the feed receives of each source over what it would unpolarised, (Nsrc,)."""
        index = find(setup.sky, self.sources)
        place = np.minimum(np.searchsorted(sources.index, index), len(sources.index) - 1)
        up = np.flatnonzero(sources.index[place] == index) if len(sources.index) else np.zeros(0, dtype=int)
        factor = np.ones(len(sources.za))
        change = self._change(setup, sources.enu[:, place[up]], sources.freq, x, up)[0]
        np.add.at(factor, place[up], change)
        return factor

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the sources' visibilities as the feed sees Q and U, and how these turn; ``x`` is (n_params,)."""
        seen = self.seen(block)
        slopes = self._in_time(block, x)[1]
        values = seen[..., np.newaxis] * slopes[:, np.newaxis]
        return Columns(values.reshape(*seen.shape[:2], len(x)), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the sources have more, (Ntimes, Nbls)."""
        return block.spread(np.einsum("tgs,ts->tg", self.seen(block), self._in_time(block, x)[0]))

    def _in_time(self, block: RowBlock, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return relative changes of flux, (Ntimes, n), and their derivatives, (Ntimes, n, n_each); zero when down."""
        ra, dec = in_radians(self.sources)
        positions = block.positions.follow(Sky(ra, dec, np.ones((1, len(ra)))))
        changes = np.zeros((len(block.times), len(ra)))
        slopes = np.zeros((*changes.shape, _n_each(block.setup)))
        for t, itime in enumerate(block.times.tolist()):
            up, za, az = positions.above_horizon(itime)
            changes[t, up], slopes[t, up] = self._change(block.setup, enu(za, az), block.freq, x, up)
        return changes, slopes

    def _change(
        self, setup: ObservingSetup, directions: FloatArray, freq: float, x: FloatArray, which: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return relative changes of flux of some of the sources, (n,), and their derivatives, (n, n_each).

        ``directions``, (3, n), are ENU.
        """
        each = _n_each(setup)
        part = x.reshape(-1, each)[which]
        rotation = np.array(self.rotation_measures)[which] + (part[:, 2] if each == 3 else 0.0)
        offset = (C_M_PER_S / freq) ** 2 - (C_M_PER_S / (self.freq or setup.reference_freq)) ** 2
        is_fixed = np.array(self.mounts)[which] == "fixed"
        turned = np.where(is_fixed, twice_angle(setup, directions), twice_angle(setup, directions, "alt-az"))
        seen = turned.conj() * np.exp(2j * rotation * offset)
        polarised = (part[:, 0] + 1j * part[:, 1]) * seen
        slopes = np.stack([seen, 1j * seen, 2j * offset * polarised], axis=1)[:, :each]
        return polarised.real, slopes.real

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of sources times those of rotation measures and mounts."""
        return len(self._looked_at(setup)) * len(rotation_grid(setup)) * len(get_args(Mount))

    def of_the_same(self, setup: ObservingSetup) -> IntArray:
        """Return the number of each candidate's source, whatever its rotation measure and its mount."""
        n_sources = len(self._looked_at(setup))
        return np.repeat(np.arange(n_sources), self.n_hypotheses(setup) // max(n_sources, 1))

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate the residual with every source at every rotation measure on every mount, (n_hypotheses, 2) each."""
        setup, grid, n_mounts = block.setup, rotation_grid(block.setup), len(get_args(Mount))

        def functions(directions: FloatArray) -> FloatArray:
            turned = [twice_angle(setup, directions, mount) for mount in get_args(Mount)]
            return np.stack([part for one in turned for part in (one.real, one.imag, one.real + one.imag)], axis=1)

        sums = dirty_map(block, setup.sky.select(self._looked_at(setup)), functions)
        # With cos, sin and their sum in the last place: (Nsrc, 1, n_mounts, 3).
        projection, power = (one.reshape(-1, 1, n_mounts, 3) for one in sums)
        offset = (C_M_PER_S / block.freq) ** 2 - (C_M_PER_S / setup.reference_freq) ** 2
        cos, sin = (turn(2 * grid * offset)[:, np.newaxis] for turn in (np.cos, np.sin))
        by_cos, by_sin, _ = np.moveaxis(projection, -1, 0)
        of_cos, of_sin, of_sum = np.moveaxis(power, -1, 0)
        product = of_sum - of_cos - of_sin  # twice that of cos and sin
        scores = [cos * by_cos + sin * by_sin, cos * by_sin - sin * by_cos]
        powers = [
            cos**2 * of_cos + sin**2 * of_sin + cos * sin * product,
            cos**2 * of_sin + sin**2 * of_cos - cos * sin * product,
        ]
        return np.stack(scores, axis=-1).reshape(-1, 2), np.stack(powers, axis=-1).reshape(-1, 2)

    def every(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        """Take all of these sources; ``hypotheses`` is (Nchosen,)."""
        return self._of(setup, hypotheses)

    @property
    def gets_simpler_when_fitted(self) -> bool:
        """Whether rotation measures lie on a grid, where several make up for one between them."""
        return len(set(self.rotation_measures)) > 1

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        """Take these candidates, the best first, without those that better ones cannot be told from; (Nchosen,).

        Of one source are taken as many rotation measures as may be tried, each the best among its neighbours.
        """
        (index, rotation, _), sky, step = self._chosen(setup, hypotheses), setup.sky, 1.5 * rotation_step(setup)
        kept: list[int] = []
        for n, (ra, dec) in enumerate(zip(sky.ra[index], sky.dec[index], strict=True)):
            places = index[kept]
            apart = separation(sky.ra[places], sky.dec[places], ra, dec) > APART * resolution(setup)
            same = rotation[kept][~apart]
            if len(same) < MOST_ROTATIONS and np.all(np.abs(same - rotation[n]) > step):
                kept.append(n)
            if len(kept) == AT_MOST:
                break
        return self._of(setup, hypotheses[kept])

    def _of(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        sky, (index, rotation, mounts) = setup.sky, self._chosen(setup, hypotheses)
        sources, trials = in_degrees(sky.ra[index], sky.dec[index]), self.n_hypotheses(setup)
        return type(self)(sources, trials, rotation.tolist(), mounts, setup.reference_freq)

    def _chosen(self, setup: ObservingSetup, hypotheses: IntArray) -> tuple[IntArray, FloatArray, list[Mount]]:
        """Return the catalogue's sources, rotation measures and mounts of some candidates, (Nchosen,) each."""
        grid, mounts = rotation_grid(setup), get_args(Mount)
        number, mount = np.divmod(hypotheses, len(mounts))
        source, rotation = np.divmod(number, len(grid))
        return self._looked_at(setup)[source], grid[rotation], [mounts[n] for n in mount.tolist()]

    def _looked_at(self, setup: ObservingSetup) -> IntArray:
        """Return the sources that are looked at, ascending, (n_sources,)."""
        at_most = max(MOST_CANDIDATES // (len(rotation_grid(setup)) * len(get_args(Mount))), 1)
        return np.sort(faintest_first(setup)[-min(self.most, at_most) :])

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Polarise all alike, at angles of their own, with rotation measures within half a step, (n_params,)."""
        scale = self.parameters(setup).scale.reshape(-1, _n_each(setup))
        angle, within = rng.uniform(0, 2 * np.pi, len(scale)), rng.uniform(-0.5, 0.5, len(scale))
        turned = np.stack([strength * np.cos(angle), strength * np.sin(angle), within], axis=1)
        return (turned[:, : scale.shape[1]] * scale).ravel()


def rotation_step(setup: ObservingSetup) -> float:
    """Return the distance of neighbouring rotation measures that are looked for, rad/m^2; zero with one channel.

    Halfway between two of them angles at the ends of the band are off by half a radian.
    """
    squares = (C_M_PER_S / setup.observation.freqs) ** 2
    return 1 / float(np.ptp(squares)) if np.ptp(squares) > 0 else 0.0


def rotation_grid(setup: ObservingSetup) -> FloatArray:
    """Return the rotation measures that are looked for, rad/m^2, (N,); zero alone with one channel."""
    if _n_each(setup) < 3:
        return np.zeros(1)
    squares, step = np.unique((C_M_PER_S / setup.observation.freqs) ** 2), rotation_step(setup)
    # Two channels do not tell those apart that turn by half a turn more from one to the other.
    largest = min(LARGEST_ROTATION, np.pi / 2 * step) if len(squares) == 2 else LARGEST_ROTATION
    n = int(largest / step)
    return np.asarray(step * np.arange(-n, n + 1))


def _n_each(setup: ObservingSetup) -> int:
    """Return the number of parameters of a source: one channel has no rotation measure."""
    return 3 if rotation_step(setup) else 2
