"""What effects see: some rows of one channel with the current model of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.sky_block import SkyBlock


@dataclass(frozen=True, eq=False, kw_only=True)
class RowBlock(SkyBlock):
    """Some rows of one channel: a rank's baselines at some times, with the sky that their groups see.

    Attributes
    ----------
    bls : ndarray of int, (Nbls,)
        Indices into the observation's baselines, which belong to ``groups``.
    member : ndarray of int, (Nbls,)
        Position in ``groups`` of each baseline's group.
    weights : ndarray, (Ntimes, Nbls)
        Inverse noise variance of the calibrated data, Jy^-2; zero where there are none.
    residual : ndarray of complex, (Ntimes, Nbls)
        Calibrated data minus A b, Jy, in the sense of the groups.
    vis : ndarray of complex, (Ntimes, Nbls)
        The model A b + E of each baseline, Jy.
    design : ndarray
        Design rows of the groups, (Ntimes, 2, Ngroups, n) or complex (Ntimes, Ngroups, n).
    moved : ndarray, (Nants, 3), optional
        By how much antennas are elsewhere, where effects in the model move them; metres ENU.
    displacing : sequence of (Effect, ndarray)
        Effects in the model by which sources are elsewhere, with their parameters: each turns or shifts the sky as the
        one before has left it.
    """

    bls: IntArray
    member: IntArray
    weights: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    residual: ComplexArray = field(default_factory=lambda: np.zeros((0, 0), dtype=complex))
    vis: ComplexArray = field(default_factory=lambda: np.zeros((0, 0), dtype=complex))
    design: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    moved: FloatArray | None = None
    displacing: Sequence[tuple[Any, FloatArray]] = ()
    _next: list[tuple[Any, FloatArray, RowBlock]] = field(default_factory=list, init=False)

    @property
    def shape(self) -> tuple[int, int]:
        """(Ntimes, Nbls)."""
        return len(self.times), len(self.bls)

    @property
    def ant1(self) -> IntArray:
        """Index of each baseline's first antenna in the sense of its group, (Nbls,)."""
        return self.setup.antenna_index[self.bls, 0]

    @property
    def ant2(self) -> IntArray:
        """Index of each baseline's second antenna in the sense of its group, (Nbls,)."""
        return self.setup.antenna_index[self.bls, 1]

    @property
    def places_in_time(self) -> IntArray:
        """Position of each of the block's times among those in use, (Ntimes,)."""
        order = np.argsort(self.setup.times)
        return order[np.searchsorted(self.setup.times, self.times, sorter=order)]

    def at_time(self, t: int) -> RowBlock:
        """Return the rows of one of the block's times."""
        now = slice(t, t + 1)
        rows = {name: getattr(self, name)[now] for name in ("times", "weights", "residual", "vis", "design")}
        return replace(self, **rows, integrals={kind: values[now] for kind, values in self.integrals.items()})

    def seen_by(self, effect: Any) -> RowBlock:
        """Return the rows as an effect has them where all that moves antennas and sources has moved them.

        What moves antennas begins from where they should be, what multiplies has the visibilities as they are, and what
        is about the beam that all share the design as it is.
        """
        return self._displaced(effect, len(self.displacing))

    def displaced_by(self, effect: Any, x: FloatArray) -> RowBlock:
        """Return the same rows with the sky displaced by an effect as well; once for the same parameters."""
        if not (effect.displaces_sky and x.any()):
            return self
        for known, at, block in self._next:
            if known is effect and np.array_equal(at, x):
                return block
        places = None if self.places is None else self.elsewhere.of(self.channel, self.places, effect, x)
        keeps_waves = self.elsewhere.most > 0 and self.own_vectors is None
        positions = effect.displaced(self, x)
        seen = self._elsewhere(positions=positions, places=places, keeps_waves=keeps_waves, followed={})
        self._next.append((effect, x.copy(), seen))
        return seen

    def _displaced(self, effect: Any, n: int) -> RowBlock:
        """Return the rows as an effect has them with the sky displaced by the first ``n`` of those that displace it."""
        if effect.multiplies or effect.is_about_the_beam or effect.is_control_model:
            return self
        seen = self
        if self.moved is not None and not effect.moves_antennas:
            seen = self._where_antennas_are
        for one, x in self.displacing[:n]:
            seen = seen.displaced_by(one, x)
        return seen

    def _place_of(self, effect: Any) -> int | None:
        """Return which of those that displace the sky an effect is; None if it is none of them."""
        return next((place for place, (one, _) in enumerate(self.displacing) if one is effect), None)

    @cached_property
    def _where_antennas_are(self) -> RowBlock:
        """The same rows, of which those of antennas that are elsewhere are groups of their own, after the others'."""
        assert self.moved is not None
        further = self.moved[self.ant2] - self.moved[self.ant1]
        is_elsewhere = further.any(axis=1)
        own = np.flatnonzero(is_elsewhere)
        stays, of_stays = np.unique(self.member[~is_elsewhere], return_inverse=True)
        member = np.empty_like(self.member)
        member[~is_elsewhere], member[own] = of_stays, len(stays) + np.arange(len(own))
        return self._elsewhere(
            own_vectors=np.concatenate([self.vectors[stays], self.vectors[self.member[own]] + further[own]]),
            own_antpos=self.antpos + self.moved,
            groups=np.arange(len(stays) + len(own)),
            member=member,
        )

    def _elsewhere(self, **changes: Any) -> RowBlock:
        """Return the rows with some fields changed, which nothing moves any more."""
        # What is kept of the sky and of groups, and design rows, are of other places or vectors.
        anew: dict[str, Any] = {"integrals": {}, "memo": None, "keeps_waves": False, "design": np.zeros((0, 0, 0))}
        return replace(self, moved=None, displacing=(), **(anew | changes))

    def added_by(self, effect: Any, x: FloatArray) -> ComplexArray:
        """Return what an effect of the model adds, (Ntimes, Nbls).

        Antennas are moved first, then those that displace the sky do so in a row, and all others see what that makes:
        what each adds to the ones before is added up.
        """
        place = 0 if effect.moves_antennas else self._place_of(effect)
        return np.asarray(effect.added(self._displaced(effect, len(self.displacing) if place is None else place), x))

    def derivative(self, effect: Any, x: FloatArray) -> Any:
        """Return the columns of an effect, `Columns`, of each baseline where antennas are elsewhere."""
        return self._by_own_rows(effect, x, effect.columns)

    def columns_of(self, effect: Any, x: FloatArray) -> Any:
        """Return the columns of an effect of the model, `Columns`, as A b has them; see `SkyBlock.columns_of`."""
        return self._by_own_rows(effect, x, lambda seen, x: SkyBlock.columns_of(seen, effect, x))

    def _by_own_rows(self, effect: Any, x: FloatArray, columns: Callable[[RowBlock, FloatArray], Any]) -> Any:
        """Return columns of rows as an effect has them, of each baseline where groups are others there."""
        seen = self.seen_by(effect)
        found = columns(seen, x) if self._place_of(effect) is None else effect.slopes(seen, x)
        return found if seen.groups is self.groups else found.of_rows(seen.member)

    def integrate_for(self, effects: Sequence[Any]) -> None:
        """Fill ``integrals`` for those of these effects that they lack, in one pass over each sky that they see."""
        seen = {id(one): one for one in (self.seen_by(effect) for effect in effects)}
        for block in seen.values():
            block._integrate_here([effect for effect in effects if self.seen_by(effect) is block])

    def spread(self, by_group: Array) -> Array:
        """Give every baseline what its group has: (Ntimes, Ngroups, ...) to (Ntimes, Nbls, ...)."""
        return by_group[:, self.member]

    def summed(self, by_bl: Array) -> Array:
        """Add up what the baselines of each group have: (Ntimes, Nbls) to (Ntimes, Ngroups)."""
        n_bls = len(self.bls)
        members = csr_array((np.ones(n_bls), (self.member, np.arange(n_bls))), (len(self.groups), n_bls))
        return np.asarray((members @ by_bl.T).T)
