"""What groups of redundant baselines see of the sky at some times, with the current model of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.data.partition import spans
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.place import Place, PlacesElsewhere
from hydrabeam_mpi.effects.interface.skies_on_rings import SkiesOnRings
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.engines import make_engine
from hydrabeam_mpi.model.engines.base import Engine, amplitude
from hydrabeam_mpi.model.engines.smearing import smearing_of
from hydrabeam_mpi.model.positions import Followed, SourcePositions
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.model.sky import Sky

AT_ALL_TIMES = -1
"""In place of a time, where something is the same at all."""
MOST_FOLLOWED = 256
"""Sets of a few sources whose places are kept: of the latest steps of a fit, one at each time where sources move."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SkyBlock:
    """Some redundant groups of one channel at some times, and the sky that they see.

    Attributes
    ----------
    setup : ObservingSetup
    channel : int
        Index into the setup's channels.
    times : ndarray of int, (Ntimes,)
        Indices into the observation's times.
    groups : ndarray of int, (Ngroups,)
        Indices of the redundant groups.
    positions : SourcePositions
    beam : callable
        The current beam of this channel.
    engine_kind : str
        As in the job.
    integrals : dict of str to ndarray of complex, (Ntimes, Ngroups, K)
        By `Effect.integrated_as`; see `Effect.sky_columns`.
    places : dict, optional
        Keeps what ``positions`` says of each time, for blocks to share where there is room for it.
    keeps_waves : bool
        Whether there is room in ``places`` for the fringes of the groups, too.
    elsewhere : PlacesElsewhere
        Keeps the same of skies that effects displace, for blocks to share.
    sky_effects : sequence of (Effect, ndarray)
        Effects in the model that change the sky, with their parameters.
    followed : dict
        Places of a few sources by the same ``positions``, which blocks share; see `follow`.
    memo : dict, optional
        Keeps what `fixed_integral` has found, for blocks to share where there is room for it.
    own_vectors : ndarray, (Ngroups, 3), optional
        Where baseline vectors are not those of the setup's groups, metres ENU.
    own_antpos : ndarray, (Nants, 3), optional
        Where antennas are not where the observation has them, metres ENU.
    """

    setup: ObservingSetup
    channel: int
    times: IntArray
    groups: IntArray
    positions: SourcePositions
    beam: Beam
    engine_kind: str = "gemm"
    integrals: dict[str, ComplexArray] = field(default_factory=dict)
    places: dict[int, Place] | None = None
    keeps_waves: bool = False
    elsewhere: PlacesElsewhere = field(default_factory=PlacesElsewhere)
    sky_effects: Sequence[tuple[Any, FloatArray]] = ()
    followed: dict[bytes, Followed] = field(default_factory=dict)
    memo: dict[tuple[int, str], tuple[dict[int, ComplexArray], dict[int, tuple[bytes, ComplexArray]]]] | None = None
    own_vectors: FloatArray | None = None
    own_antpos: FloatArray | None = None
    _sources: dict[int, Sources] = field(default_factory=dict, init=False)

    @property
    def freq(self) -> float:
        """Hz."""
        return float(self.setup.observation.freqs[self.channel])

    @property
    def vectors(self) -> FloatArray:
        """Baseline vectors of the groups, (Ngroups, 3), metres ENU."""
        return self.setup.redundant.vectors[self.groups] if self.own_vectors is None else self.own_vectors

    @property
    def antpos(self) -> FloatArray:
        """Places of the antennas, (Nants, 3), metres ENU."""
        return self.setup.observation.antpos if self.own_antpos is None else self.own_antpos

    @cached_property
    def engine(self) -> Engine:
        """The job's engine on the groups' vectors, most of which are differences of antennas' places."""
        return self.engine_on(self.vectors, self.antpos)

    def engine_on(self, vectors: FloatArray, points: FloatArray | None = None) -> Engine:
        """Return the job's engine on baseline vectors, (N, 3), which may be differences of ``points``; metres ENU."""
        return make_engine(self.engine_kind, vectors, points, smearing_of(self.setup.observation))

    def follow(self, ra: FloatArray, dec: FloatArray) -> Followed:
        """Follow a few sources, (Nsrc,) each, radians: channels have their places in common."""
        key = ra.tobytes() + dec.tobytes()
        if key not in self.followed:
            if len(self.followed) == MOST_FOLLOWED:
                self.followed.clear()
            self.followed[key] = Followed(self.positions.follow(Sky(ra, dec, np.ones((1, len(ra))))))
        return self.followed[key]

    def sources(self, itime: int) -> Sources:
        """Return the sources above the horizon at an observation's time."""
        if itime in self._sources:
            return self._sources[itime]
        setup, place = self.setup, self._place(itime)
        known = place.seen(self.channel, self.beam, self.sky_effects)
        if known is not None:
            return known
        flux = place.flux(self.channel, setup.sky.flux)
        sources = Sources(place.index, place.za, place.az, flux, self.beam, freq=self.freq, itime=itime)
        # A cached property that is known already.
        vars(sources)["enu"] = place.enu
        for effect, x in self.sky_effects:
            factor = effect.sky_factor(setup, sources, x)
            if factor is not None:
                # Two of a kind add up, as more parameters of one do.
                sources.factors[effect.kind] = sources.factors.get(effect.kind, 1.0) + factor - 1
        place.keep(self.channel, self.beam, self.sky_effects, sources)
        return sources

    def further_sources(self, itime: int) -> Sources | None:
        """Return the point sources that effects add to the sky at a time; None where there are none.

        What stands for diffuse emission is not among them: it is too faint for what effects change of it to matter.
        """
        added = [
            more
            for effect, x in self.sky_effects
            if effect.standing_numbers(self, itime, x) is None
            and (more := effect.extra_sky(self, itime, x)) is not None
        ]
        if not added:
            return None
        za, az, flux = (np.concatenate(parts) for parts in zip(*added, strict=True))
        return Sources(np.full(len(za), -1), za, az, flux, self.beam, freq=self.freq, itime=itime)

    def _place(self, itime: int) -> Place:
        if self.places is None:
            return Place(*self.positions.above_horizon(itime))
        if itime not in self.places:
            self.places[itime] = Place(*self.positions.above_horizon(itime))
        return self.places[itime]

    def integrate(
        self,
        columns: Callable[[Sources], FloatArray],
        vectors: FloatArray | None = None,
        flux: Literal["within columns"] | None = None,
        engine: Engine | None = None,
    ) -> ComplexArray:
        """Integrate real columns over the sky at every time of the block, with the point sources that effects add.

        Parameters
        ----------
        columns : callable
            From `Sources` to an array (K, Nsrc); called once for those of the sky model, and once for those added.
        vectors : ndarray, (N, 3), optional
            Baseline vectors, metres ENU; the groups' own by default.
        flux : "within columns", optional
            Where the columns hold the fluxes already.
        engine : Engine, optional
            In place of the job's one on these vectors.

        Returns
        -------
        ndarray of complex, (Ntimes, N, K)
            1/2 sum_s I_s column_k(s) exp(2 pi i nu b.s / c), Jy.
        """
        engine = engine or (self.engine if vectors is None else self.engine_on(vectors))
        freqs = np.array([self.freq])
        out = []
        for itime in self.times.tolist():
            total: Any = 0.0
            of_model, further = self.sources(itime), self.further_sources(itime)
            for sources in (of_model, further) if further else (of_model,):
                weights = sources.flux_without() if flux is None else np.ones(len(sources.za))
                values, keeps = columns(sources), self.keeps_waves and itime not in self._sources
                if engine is self.engine and keeps and sources is of_model:
                    waves = self._place(itime).waves(self.channel, engine, self.freq)
                    design = (waves @ (amplitude(weights) * values).T).reshape(2, engine.n_vectors, -1)
                else:
                    design = engine.design(GivenColumns(values), sources.za, sources.az, weights[np.newaxis], freqs)[0]
                total = total + design[0] + 1j * design[1]
            out.append(total)
        return np.array(out)

    def fixed_integral(self, name: str, columns: Callable[[Sources], FloatArray]) -> ComplexArray:
        """Integrate columns that do not depend on the beam: once, where there is room to keep it.

        Where effects change the sky, what they change and add is integrated besides. The result is (Ntimes, N, K).

        Parameters
        ----------
        name : str
            Of these columns.
        columns : callable
            As for `integrate`.
        """
        if self.memo is None or not len(self.times):
            return self.integrate(columns)
        sky = b"".join(x.tobytes() for effect, x in self.sky_effects)
        as_it_is, changed = self.memo.setdefault((self.channel, name), ({}, {}))
        new = np.array([time for time in self.times.tolist() if time not in as_it_is], dtype=int)
        if len(new):
            integrals = replace(self, times=new, sky_effects=()).integrate(columns)
            as_it_is.update(zip(new.tolist(), integrals, strict=True))
        if not sky:
            return np.array([as_it_is[time] for time in self.times.tolist()])
        for time in self.times.tolist():
            if changed.get(time, (b"",))[0] != sky:
                changed[time] = sky, as_it_is[time] + self._change_of_sky(time, columns)
        return np.array([changed[time][1] for time in self.times.tolist()])

    def _change_of_sky(self, itime: int, columns: Callable[[Sources], FloatArray]) -> ComplexArray:
        """Integrate what effects change of the fluxes, (N, K), over the sources whose fluxes they change or add."""
        sources = self.sources(itime)
        which, change = sources.changed
        some = Sources(sources.index[which], sources.za[which], sources.az[which], change, sources.beam_function)
        one_time = replace(self, times=np.array([itime]))
        one_time._sources[itime] = some
        return one_time.integrate(columns)[0]

    def columns_of(self, effect: Any, x: FloatArray) -> Any:
        """Return the columns of an effect of the model, `Columns`, as A b has them where it is part of that.

        Effects see the real part of the beam, which is what a beam has. But complex coefficients give A b an imaginary
        one too, and what changes the sky changes A: without it steps of a fit would lead astray where the data tell
        little of that part, as of the beam on a faint sky.
        """
        columns, of_imaginary = effect.columns(self, x), self._of_imaginary_beam
        if of_imaginary is None or not effect.changes_sky:
            return columns
        return replace(columns, values=columns.values + 1j * effect.columns(of_imaginary, x).values)

    @cached_property
    def _of_imaginary_beam(self) -> Self | None:
        """The same with the imaginary part of the beam in its place; None where that has none."""
        imaginary: Beam | None = getattr(self.beam, "imaginary", None)
        return None if imaginary is None else replace(self, beam=imaginary, integrals={})

    def diffuse_integral(self, name: str, basis: LinearBasis) -> ComplexArray:
        """Return what the functions of a real basis see of the diffuse emission that effects add to the sky.

        The skies of which that is made do not turn: what is seen of them is found once, where there is room to keep it.
        The result is (Ntimes, Ngroups, n_modes).

        Parameters
        ----------
        name : str
            Of these functions.
        basis : LinearBasis
        """
        out = np.zeros((len(self.times), len(self.groups), basis.n_modes), dtype=complex)
        for effect, x in self.sky_effects:
            for t, itime in enumerate(self.times.tolist()):
                numbers = effect.standing_numbers(self, itime, x)
                if numbers is None:
                    break
                if self.memo is not None:
                    out[t] += np.tensordot(numbers, self._seen_standing(name, effect, basis), axes=1)
                    continue
                za, az, flux = effect.extra_sky(self, itime, x)
                design = self.engine.design(basis, za, az, flux[np.newaxis], np.array([self.freq]))
                out[t] += _by_modes(basis, design)[0]
        return out

    def _seen_standing(self, name: str, effect: Any, basis: LinearBasis) -> ComplexArray:
        """Return what functions see of each of an effect's skies that do not turn, (K, Ngroups, n_modes); kept."""
        assert self.memo is not None
        kept, _ = self.memo.setdefault((self.channel, f"{name} {effect.kind} {effect.describe()}"), ({}, {}))
        if AT_ALL_TIMES not in kept:
            kept[AT_ALL_TIMES] = _by_modes(basis, self.standing_design(self.engine, effect, basis))
        return kept[AT_ALL_TIMES]

    def standing_design(self, engine: Engine, effect: Any, basis: LinearBasis) -> FloatArray:
        """Return the design of each of an effect's skies that do not turn, (K, 2, N, n_columns), on N vectors."""
        skies: SkiesOnRings = effect.standing_skies(self)
        return skies.design(engine, basis, self.freq)

    def integral(self, effect: Any) -> ComplexArray:
        """Return what an effect needs integrated over the sky, (Ntimes, Ngroups, K); see `Effect.sky_columns`."""
        self._integrate_here([effect])
        return self.integrals[effect.integrated_as]

    def _integrate_here(self, effects: Sequence[Any]) -> None:
        """Fill ``integrals`` for those of these effects that they lack, in one pass over the sky."""
        lacking = {one.integrated_as: one for one in effects if one.integrated_as not in self.integrals}
        first = self.sources(int(self.times[0])) if lacking and len(self.times) else None
        effects = [one for one in lacking.values() if first is not None and one.sky_columns(first) is not None]
        if not effects:
            return
        sizes: dict[str, int] = {}

        def columns(sources: Sources) -> FloatArray:
            parts = {one.integrated_as: one.sky_columns(sources) * sources.flux_without(one.kind) for one in effects}
            sizes.update({name: len(part) for name, part in parts.items()})
            return np.concatenate(list(parts.values()))

        integrals = self.integrate(columns, flux="within columns")
        for name, span in zip(sizes, spans(sizes.values()), strict=True):
            self.integrals[name] = integrals[..., span]


def _by_modes(basis: LinearBasis, design: FloatArray) -> ComplexArray:
    """Return what a real basis's functions see, (K, N, n_modes), of a design by its columns, (K, 2, N, n_columns)."""
    return np.asarray(basis.mix(design[:, 0]) + 1j * basis.mix(design[:, 1]))


class GivenColumns:
    """Columns that are known already, for an engine that asks for them run by run in the order of the sources."""

    def __init__(self, values: FloatArray) -> None:
        self.values = values
        self.n_columns = len(values)
        self._next = 0

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Return the next ``len(za)`` sources' columns, (n_columns, Npoints)."""
        part = self.values[:, self._next : self._next + len(za)]
        self._next += len(za)
        if out is None:
            return part
        out[:] = part
        return out
