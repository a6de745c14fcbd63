"""The forward model of a rank's rows: their design, and the blocks that effects see of them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.place import Place, PlacesElsewhere
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.displacing import with_displacing
from hydrabeam_mpi.fit.accumulate import designs, mixed
from hydrabeam_mpi.fit.changed_sky import changed_sky, design_of_each
from hydrabeam_mpi.fit.kept import Kept
from hydrabeam_mpi.fit.known_precision import RecentlyKnown
from hydrabeam_mpi.fit.linear_sky import LinearSky, linear_sky
from hydrabeam_mpi.fit.room import KEPT_BYTES, Room
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.model.positions import Followed
from hydrabeam_mpi.model.rime import Beam, ForwardModel
from hydrabeam_mpi.setup.problem import Problem

SLOPES_BYTES = KEPT_BYTES / 8
"""What the design changes by with each parameter of the sky is kept if it is smaller: adding up more than that takes
about as long as working out the design of a sky anew."""
SKIES_OF_A_FIT = 30
"""Designs of a changed sky that a fit wants: one a step, of which it takes some and `gauss_newton.MAX_STEPS` at most,
and it is made again with other widths of the prior. Those of skies that do not turn are made once for all of them, and
for all fits that follow, by as many products on each ring as there are functions of azimuth."""

STANDING_BYTES = 2**26
"""Of the designs of several times that are made of such skies at once: the skies are gone through once for all of
them."""


@dataclass
class RowModel:
    """The forward model of some rows.

    Attributes
    ----------
    problem : Problem
        Of the rank group's channels.
    setup : ObservingSetup
        Of all channels.
    rows : Rows
        As read.
    linear_sky : LinearSky, optional
        The design of all skies that some effects make.
    kept_bytes : float
        That the design may take, to be kept.
    """

    problem: Problem
    setup: ObservingSetup
    rows: Rows
    linear_sky: LinearSky | None = None
    kept_bytes: float = KEPT_BYTES
    _places: dict[int, Place] = field(default_factory=dict)
    _followed: dict[bytes, Followed] = field(default_factory=dict)
    _memo: dict[tuple[int, str], Any] = field(default_factory=dict)
    _skies: dict[tuple[int, str, str], FloatArray] = field(default_factory=dict)

    @cached_property
    def room(self) -> Room:
        """What is kept of these rows."""
        sizes = len(self.rows.tile.times), len(self.rows.groups), len(self.rows.data)
        return Room.of(*sizes, self.problem.basis.n_modes, self.setup.sky.Nsrc, self.kept_bytes)

    @cached_property
    def _elsewhere(self) -> PlacesElsewhere:
        return PlacesElsewhere(self.room.skies_elsewhere if self.problem.job.solver.engine == "gemm" else 0)

    @cached_property
    def model(self) -> ForwardModel:
        """The forward model of the rows' groups."""
        return self.problem.forward_model(self.rows.groups)

    @cached_property
    def model_beam(self) -> ComplexArray:
        """Visibilities of the model beam with nothing fitted, (Nlocal, Ntimes, Ngroups)."""
        return self.model.visibilities(self.problem.beams, self.rows.tile.times)

    @cached_property
    def _plain(self) -> Kept[Array]:
        return Kept(self.room.designs)

    @cached_property
    def _changed(self) -> Kept[Array]:
        return Kept(self.room.designs)

    @cached_property
    def known(self) -> RecentlyKnown:
        """How well the beams are known, which many fits have in common."""
        return RecentlyKnown()

    @cached_property
    def known_when_held_out(self) -> RecentlyKnown:
        """What these rows would tell of the beams, by which their density as others predict it is worked out."""
        return RecentlyKnown()

    def designs(self, values: Values, show: bool = False) -> Iterator[Array]:
        """Yield the design of each time, (Nfreqs, ..., Ngroups, n_modes), as the function `designs` does.

        Effects that change the sky are part of them.
        """

        def plain() -> Iterator[Array]:
            return designs(self.rows, self.model, self.problem.basis, "design matrix", show)

        of_sky, key = self._plain.of(None, plain), self.key_of_sky(values)
        if not key:
            return of_sky
        sky = self.linear_sky
        if sky is not None and sky.has(values):
            return self._changed.of(key, lambda: sky.designs(values))
        return self._changed.of(key, lambda: map(np.add, of_sky, self._changes(values)))

    def learn_sky(self, values: Values, moving: Sequence[int]) -> None:
        """Work out from what the designs of all skies follow that some effects make, where there is room. Serial.

        Parameters
        ----------
        values : Values
        moving : sequence of int
            Places of the effects that will have many values.
        """
        places = [place for place in moving if values.active[place].effect.changes_sky]
        n_slopes = sum(values.active[place].size for place in places)
        n_rows = len(self.rows.groups) * len(self.rows.tile.times) * len(self.rows.data)
        if places and n_slopes * n_rows * self.problem.basis.n_modes * 16 <= SLOPES_BYTES:
            self.linear_sky = linear_sky(self.designs, values, places, self.problem.channel_numbers.tolist())

    def key_of_sky(self, values: Values) -> bytes:
        """Return what tells the sky with its effects from another one; nothing where there are none."""
        return b"".join(one.x.tobytes() for one in values.active if one.effect.changes_sky)

    def _changes(self, values: Values) -> Iterator[Array]:
        """Yield what effects change of the design rows: of sources whose flux they change, and of further ones."""
        basis, engine, times = self.problem.basis, self.model.engine, self.rows.tile.times.tolist()
        blocks = [self.block(channel, slice(None), _no_beam, values) for channel in range(len(self.rows.data))]
        freqs = np.array([block.freq for block in blocks])
        stands = [self._keeps_skies(one, blocks[0]) for one, _ in blocks[0].sky_effects] if times else []
        skies = (changed_sky(blocks, time, stands) for time in times)
        designs = design_of_each(engine, basis, skies, freqs)
        standing = [
            [
                self._of_standing(one, x, channel, block)
                for (one, x), is_it in zip(block.sky_effects, stands, strict=True)
                if is_it
            ]
            for channel, block in enumerate(blocks)
        ]
        for turning in designs:
            for of_channel, skies_of_channel in zip(turning, standing, strict=True):
                for seen in skies_of_channel:
                    of_channel += next(seen)
            yield mixed(basis, turning)

    def _of_standing(self, effect: Effect, x: FloatArray, channel: int, block: RowBlock) -> Iterator[FloatArray]:
        """Yield the design of what an effect adds of skies that do not turn, (2, Ngroups, n_columns), at each time."""
        of_skies = self._design_of_skies(effect, channel, block)
        flat = of_skies.reshape(len(of_skies), -1)
        at_once = max(1, int(STANDING_BYTES // (8 * flat.shape[1])))
        times = block.times.tolist()
        for first in range(0, len(times), at_once):
            numbers = np.array([effect.standing_numbers(block, t, x) for t in times[first : first + at_once]])
            yield from (numbers @ flat).reshape(-1, *of_skies.shape[1:])

    def _keeps_skies(self, effect: Effect, block: RowBlock) -> bool:
        """Whether designs of an effect's skies that do not turn take less time, and room, than one at each time."""
        if _key_of_skies(0, effect) in self._skies:
            return True
        skies = effect.standing_skies(block)
        if skies is None:
            return False
        size = 16 * len(skies.across) * len(self.rows.groups) * self.problem.basis.n_columns * len(self.rows.data)
        return len(skies.along) <= SKIES_OF_A_FIT * len(self.rows.tile.times) and size <= SLOPES_BYTES

    def _design_of_skies(self, effect: Effect, channel: int, block: RowBlock) -> FloatArray:
        """Return the design of each of an effect's skies that do not turn, (K, 2, Ngroups, n_columns); made once."""
        key = _key_of_skies(channel, effect)
        if key not in self._skies:
            self._skies[key] = block.standing_design(self.model.engine, effect, self.problem.basis)
        return self._skies[key]

    def block(self, channel: int, span: slice, beam: Beam, values: Values, **data: Any) -> RowBlock:
        """Return the block of some of the rank's times; ``data`` are fields of `RowBlock` about its rows."""
        number = int(self.problem.channel_numbers[channel])
        block = RowBlock(
            setup=self.setup,
            channel=number,
            times=self.rows.tile.times[span],
            bls=self.rows.tile.bls,
            groups=self.rows.groups,
            member=self.rows.member,
            positions=self.model.positions,
            beam=beam,
            engine_kind=self.problem.job.solver.engine,
            places=self._places if self.room.places else None,
            keeps_waves=self.room.waves and self.problem.job.solver.engine == "gemm",
            elsewhere=self._elsewhere,
            sky_effects=[(one.effect, one.x[number]) for one in values.active if one.effect.changes_sky],
            memo=self._memo if self.room.designs else None,
            followed=self._followed,
            **data,
        )
        return with_displacing(block, [(one.effect, one.x[number]) for one in values.active])


def _key_of_skies(channel: int, effect: Effect) -> tuple[int, str, str]:
    return channel, effect.kind, json.dumps(effect.describe())


def _no_beam(za: FloatArray, az: FloatArray) -> FloatArray:
    """Stand in for a beam that nobody asks for."""
    return np.zeros(len(za))
