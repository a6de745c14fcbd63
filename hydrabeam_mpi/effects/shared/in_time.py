"""Effects whose parameters change in time: x_p(t) = sum_k x_pk phi_k(t), with the functions phi_k of a law.

What is constant is left to the effect itself, of which this is a further one. The columns of a number x_pk are the
effect's own, of each time with what its parameters are then, times phi_k(t). Nothing else is needed to
weigh a change in time beside everything else, and no more than that it costs: its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.changing import Undecided
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect, sums_by
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.anew_law import Anew
from hydrabeam_mpi.effects.shared.correlated_law import Correlated
from hydrabeam_mpi.effects.shared.displaced import added_by_displacing
from hydrabeam_mpi.effects.shared.nightly_laws import Nightly, Sidereal
from hydrabeam_mpi.effects.shared.time_laws import LEVEL, Piecewise, Smooth, TimeLaw
from hydrabeam_mpi.model.positions import PositionsByTime, SourcePositions

LAWS: dict[str, type[TimeLaw]] = {law.name: law for law in (Smooth, Sidereal, Nightly, Piecewise, Anew, Correlated)}
"""By the names that jobs give them."""
LEAST_TIMES = 4
"""Fitted times that tell a slope and a curvature and still contradict them."""
MOST_COLUMNS = 300
"""Parameters that are weighed together: of all antennas with the functions of time that explain most by themselves, as
many as take the time of a few other effects. More come a round later."""
LEAST_FUNCTIONS = 2
"""However many antennas there are: with one alone nothing is chosen."""

Times = IntArray | Sequence[int] | slice
EVERY = slice(None)


class InTime(ScannedEffect):
    """An effect that changes in time by a law.

    Where the effect has few enough elements (antennas) it is the functions that are scanned; else it is the effect's
    own candidates (baselines, sources), each with the first few functions.

    Parameters
    ----------
    effect : Effect
        Of which one has to be able to say how it goes on in time.
    law : TimeLaw
    """

    gets_simpler_when_fitted = False

    def __init__(self, effect: Effect, law: TimeLaw) -> None:
        self.effect, self.time_law = effect, law
        self.kind, self.title, self.law = effect.kind, effect.title_in_time(law.name), law.name
        self.shared, self.of_the_sky = effect.shared, effect.of_the_sky
        self.local = "times" if law.is_of_single_times else effect.local
        self.of_both_feeds, self.unphysical = effect.of_both_feeds, effect.unphysical
        self.is_seen_by_beam = effect.is_seen_by_beam
        self.multiplies, self.changes_sky, self.linear = effect.multiplies, effect.changes_sky, effect.linear
        self.displaces_sky = effect.displaces_sky

    def describe(self) -> dict[str, Any]:
        """Return what makes the effect, and the law."""
        return {**self.effect.describe(), **self.time_law.describe()}

    def same_in_all_channels(self) -> InTime | None:
        """Return what changes alike in all channels, where the effect has such a form."""
        alike = self.effect.same_in_all_channels()
        return None if alike is None else type(self)(alike, self.time_law)

    def in_full(self, setup: ObservingSetup) -> InTime:
        """Return the effect with its law over the times of the data."""
        return type(self)(self.effect, self.time_law.over(setup.jd))

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several times."""
        fitted = setup.fitted_jd
        if len(fitted) < LEAST_TIMES:
            return f"a change in time needs {LEAST_TIMES} fitted times or more; there are {len(fitted)}"
        return self.time_law.not_applicable(fitted, setup.jd) or self.effect.not_applicable(setup)

    def carried_over(self, setup: ObservingSetup) -> InTime | str:
        """Return the effect in other data, where these are of the same hours: nobody knows how it went on."""
        if not self.time_law.covers(setup.jd):
            return "changes in time, by a law that is known for the times of the data in which it was found"
        here = self.effect.carried_over(setup)
        return here if isinstance(here, str) else type(self)(here, self.time_law)

    def anew(self, setup: ObservingSetup) -> tuple[InTime, dict[str, dict[str, float]]] | None:
        """Return the effect with the law over other times: it changes as much there, but nobody knows how."""
        law, here = self.time_law.anew(setup.jd), self.effect.carried_over(setup)
        if law is None or isinstance(here, str):
            return None
        effect, before = type(self)(here, law[0]), self.time_law.names()
        own = effect._own_parameters(setup).names
        sizes: dict[str, dict[str, float]] = {}
        for name, (number, _) in here.known_as(own).items():
            for function, alike in zip(law[0].names(), law[1], strict=True):
                size = sizes.setdefault(f"{own[number]}, {function}", {})
                size.update({f"{name}, {before[i]}": 1 / len(alike) for i in alike})
        return effect, sizes

    def known_as(self, names: Sequence[str]) -> dict[str, tuple[int, float]]:
        """Return the parameters by the names that the effect's own have, with those of the functions."""
        functions = self.time_law.names()
        n = max(len(functions), 1)
        own = self.effect.known_as([name.removesuffix(f", {functions[0]}") for name in names[::n]])
        return {
            f"{name}, {function}": (n * number + k, sign)
            for name, (number, sign) in own.items()
            for k, function in enumerate(functions)
        }

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return those of the effect with each of the functions; an element is one of its own with one function.

        With single times it is one of its own: how large they all are is all that there is to find.
        """
        own, functions = self._own_parameters(setup), self.time_law.names()
        n, of = len(functions), self._candidates(setup)
        number = np.arange(n)
        names = [f"{name}, {function}" for name in own.names for function in functions]
        units = [unit for unit in own.units for _ in functions]
        single = self.time_law.is_of_single_times
        element = np.repeat(own.element, n) if single else (n * own.element[:, np.newaxis] + number).reshape(-1)
        of_functions = len(of.names()) if len(own) and n else 0
        parameters = Parameters.of(names, units, np.repeat(own.scale, n), element, trials=own.trials * of_functions)
        parameters = replace(parameters, sort=None if own.sort is None else np.repeat(own.sort, n))
        if isinstance(self.effect, ScannedEffect):
            return parameters
        n_common = len(self.effect.common_in_time(setup)[0])
        common = np.arange(len(own)) >= len(own) - n_common
        across = (n * np.cumsum(common)[:, np.newaxis] + number).reshape(-1)
        return replace(parameters, across=across, across_trials=(1 + n_common) * of_functions)

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return what no data tell, with each of the functions by itself, (n_directions, n_params)."""
        functions, n_common = self.time_law.names(), len(self.effect.common_in_time(setup)[0])
        changing = np.pad(self.effect.undecidable_in_time(setup), ((0, 0), (0, n_common)))
        of_level = self._undecidable_level(setup) if LEVEL in functions else changing
        each = zip(functions, np.eye(len(functions)), strict=True)
        found = [np.kron(of_level if name == LEVEL else changing, one) for name, one in each]
        return np.vstack([np.zeros((0, changing.shape[1] * len(functions))), *found])

    def _undecidable_level(self, setup: ObservingSetup) -> FloatArray:
        """Return what no data tell of a level, (n_directions, n_own).

        It is as little told from another beam as what is constant, and as what all elements have in common then.
        """
        common, constant = self.effect.common_in_time(setup)[1], self.effect.degenerate_directions(setup)
        is_constant = np.linalg.norm(common - common @ np.linalg.pinv(constant) @ constant, axis=1) < 1e-9
        of_common = np.eye(len(common))[is_constant]
        return np.vstack(
            [
                np.pad(constant, ((0, 0), (0, len(common)))),
                np.pad(of_common, ((0, 0), (constant.shape[1], 0))),
            ]
        )

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the effect's own columns times the functions; ``x`` is (n_params,)."""
        return self.slopes(block.displaced_by(self, x), x)

    def slopes(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the columns where an effect that displaces the sky has done so; ``x`` is (n_params,)."""
        own = self._own_columns(block, x)
        functions = self._functions(block.setup)[block.times]
        n = functions.shape[1]
        if self.time_law.is_of_single_times and n:
            by_time = np.array([functions.any(axis=1), functions.argmax(axis=1)])[..., np.newaxis, np.newaxis]
            of_own = np.arange(own.n_params) if own.index is None else own.index
            number = np.broadcast_to(n * of_own + by_time[1], own.values.shape)
            return Columns(own.values * by_time[0], n * own.n_params, number, own.by_group)
        values = own.values[..., np.newaxis] * functions[:, np.newaxis, np.newaxis]
        index = None if own.index is None else _several(n * own.index[..., np.newaxis] + np.arange(n))
        return Columns(_several(values), n * own.n_params, index, own.by_group)

    def sky_columns(self, sources: Sources) -> FloatArray | None:
        """Return what the effect needs integrated over the sky at one time, (K, Nsrc) real."""
        return self.effect.sky_columns(sources)

    @property
    def integrated_as(self) -> str:
        """The name of what the effect itself needs."""
        return self.effect.integrated_as

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return E, (Ntimes, Nbls)."""
        if self.multiplies or self.linear:
            return super().added(block, x)
        if self.displaces_sky:
            return added_by_displacing(self, block, x)
        now = self._at_times(block.setup, x, block.times)
        return np.concatenate([self.effect.added(block.at_time(t), one) for t, one in enumerate(now)])

    def displaced(self, block: RowBlock, x: FloatArray) -> SourcePositions:
        """Return where sources are by the effect as it is at each of the block's times."""
        now = self._at_times(block.setup, x, block.times)
        pairs = enumerate(zip(block.times.tolist(), now, strict=True))
        return PositionsByTime({time: self.effect.displaced(block.at_time(t), one) for t, (time, one) in pairs})

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return C, (Ntimes, Nbls)."""
        if not self.multiplies:
            return super().factor(block, x)
        at_times = zip(block.times.tolist(), self._at_times(block.setup, x, block.times), strict=True)
        rows = [self.effect.factor(replace(block, times=np.array([itime])), now)[0] for itime, now in at_times]
        return np.array(rows).reshape(block.shape)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return the gains of all antennas at all times, (Ntimes, Nants)."""
        return np.array([self.effect.gains(setup, channel, now) for now in self._at_times(setup, x)])

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray | None:
        """Return what multiplies each source's flux at its time, (Nsrc,)."""
        return self.effect.sky_factor(setup, sources, self._at_times(setup, x, [sources.itime])[0])

    def extra_sky(self, block: RowBlock, itime: int, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Return further sources as they are at one time; see `Effect.extra_sky`."""
        return self.effect.extra_sky(block, itime, self._at_times(block.setup, x, [itime])[0])

    def begun(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the functions that come nearest to what the effect itself begins with at each time."""
        functions, rows = self._functions(setup)[setup.times], np.atleast_2d(x)
        now = np.array([self._at_times(setup, row, setup.times) for row in rows])
        change = np.linalg.pinv(functions) @ (self.effect.begun(setup, now) - now)  # (n_rows, n functions, n_own)
        more = np.moveaxis(change, 1, 2).reshape(len(rows), -1)
        more = np.pad(more, ((0, 0), (0, rows.shape[1] - more.shape[1])))  # what all have in common stays
        stays = (rows == 0) & ~self.needed_at(setup, x)[2]
        return np.where(stays, 0.0, rows + more).reshape(x.shape)

    def needed_at(self, setup: ObservingSetup, x: FloatArray) -> tuple[Effect, IntArray, BoolArray]:
        """Return the effect, and all functions of what it needs itself at one of the times."""
        needed = super().needed_at(setup, x)[2]
        if self.multiplies:
            now = np.array([self._at_times(setup, row, setup.times) for row in np.atleast_2d(x)])
            own = np.repeat(self.effect.needed_at(setup, now)[2], len(self.time_law.names()))
            needed[: len(own)] = own
        return self, np.arange(len(needed)), needed

    def without_turns(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the effect's own parameters nearest to zero at each jump, (..., n_params); a drift stays as it is."""
        if not isinstance(self.time_law, Piecewise):
            return x
        n_own, by_jump = len(self.effect.parameters(setup)), x.reshape(*x.shape[:-1], -1, len(self.time_law.names()))
        own = self.effect.without_turns(setup, by_jump[..., :n_own, :].swapaxes(-1, -2)).swapaxes(-1, -2)
        return np.concatenate([own, by_jump[..., n_own:, :]], axis=-2).reshape(x.shape)

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Return how far the effect's own parameters, without what is constant of them, are beyond at the worst time.

        Each of a parameter's numbers in use counts as that far beyond; their errors are taken as independent. See
        `Effect.beyond`.
        """
        functions, n_own = self._functions(setup)[setup.times], len(self.effect.parameters(setup))
        n = functions.shape[1]
        now, variance = (
            np.einsum("tk,fpk->tfp", weights, one[:, : n_own * n].reshape(-1, n_own, n))
            for weights, one in ((functions, x), (functions**2, std**2))
        )
        pairs = zip(now, np.sqrt(variance), strict=True)
        worst = np.max([self.effect.beyond(setup, *one) for one in pairs], axis=0, initial=0.0)
        beyond = np.pad(np.repeat(worst, n), (0, x.shape[1] - n_own * n))
        return np.where(np.any(std > 0, axis=0), beyond, 0.0)

    def without(self, gone: BoolArray) -> tuple[InTime, IntArray]:
        """Return the effect without what some parameters belong to, and the numbers of those left, (n_left,).

        ``gone`` is (n_params,).
        """
        n = len(self.time_law.names())
        effect, left = self.effect.without(np.any(gone.reshape(-1, n), axis=1))
        return type(self)(effect, self.time_law), (n * left[:, np.newaxis] + np.arange(n)).ravel()

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of the effect's candidates, or where it has none that of functions."""
        if isinstance(self.effect, ScannedEffect):
            return self.effect.n_hypotheses(setup)
        return len(self._scanned(setup)[1])

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Return the sums for every candidate, each (n_hypotheses, p): s phi_k is correlated as s is."""
        if isinstance(self.effect, ScannedEffect):
            return self.effect.scan_in_time(block, self.scanned_functions(block))
        functions = self._scanned(block.setup)[0][block.times]
        told, power = self._sums_of_times(block)
        return functions.T @ told, functions.T**2 @ power

    def scanned_functions(self, block: RowBlock) -> FloatArray:
        """Return the functions with which candidates are scanned, (Ntimes, k)."""
        return self._candidates(block.setup).functions(block.setup.observation.times)[block.times]

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return all that jumps as what is constant, as it is at most times, and what is anew at each as a drift.

        What is constant a jump near the first time explains nearly as well, and with what all antennas have in common.
        """
        if isinstance(self.time_law, Anew):
            law, n = (
                Smooth().over(setup.jd).candidates(setup.fitted_jd, setup.jd).with_level(),
                len(self.time_law.names()),
            )
            rows = zip(x.mean(axis=0).reshape(-1, n), std.mean(axis=0).reshape(-1, n), strict=True)
            begun = [self.time_law.followed_by(law, setup.fitted_jd, *row) for row in rows]
            return [(np.ones(x.shape[1], dtype=bool), type(self)(self.effect, law), np.concatenate(begun))]
        if not isinstance(self.time_law, Piecewise):
            return []
        fitted = setup.times if setup.fitted is None else setup.fitted
        levels = [self._at_times(setup, one, fitted) for one in x]
        return [(np.ones(x.shape[1], dtype=bool), self.effect, np.median(levels, axis=1).mean(axis=0))]

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> InTime:
        """Return the effect with the best candidates; ``hypotheses`` is (Nchosen,)."""
        law = self._candidates(setup)
        if isinstance(self.effect, ScannedEffect):
            n_each = 2 * len(law.names())
            return type(self)(self.effect.at(setup, hypotheses[: max(MOST_COLUMNS // max(n_each, 1), 1)]), law)
        most = max(MOST_COLUMNS // len(self.effect.parameters(setup)), LEAST_FUNCTIONS)
        return type(self)(self.effect, law.at(law.best(self._scanned(setup)[1][hypotheses], most)))

    def drawn(self, setup: ObservingSetup, rng: np.random.Generator) -> InTime:
        """Pick an element at random, or a function."""
        law = self.time_law.over(setup.jd) if self.time_law.names() else self._candidates(setup)
        if isinstance(self.effect, ScannedEffect):
            return type(self)(self.effect.drawn(setup, rng), law)
        return type(self)(self.effect, law.at(rng.integers(len(law.names()), size=1)))

    def alternatives(self, setup: ObservingSetup, used: IntArray) -> list[Undecided[InTime]]:
        """Return the effect with each function in use as it may be as well by the times that are fitted."""
        n, found = len(self.time_law.names()), list[Undecided[InTime]]()
        times = setup.times[np.argsort(setup.observation.times[setup.times])]
        for number in np.unique(used % n).tolist() if n else ():
            laws = self.time_law.alternatives(number, setup.fitted_jd, setup.jd)
            changed = [(law.functions(setup.jd) != self.time_law.functions(setup.jd)).any(axis=1) for law in laws]
            others = [type(self)(self.effect, law) for law in laws]
            found.append(Undecided(times[np.any(changed, axis=0)] if laws else times[:0], others))
        return found

    def _candidates(self, setup: ObservingSetup) -> TimeLaw:
        """Return the law with all functions that are looked at."""
        law = self.time_law.over(setup.jd).candidates(setup.fitted_jd, setup.jd)
        return law.first(self.effect.functions_in_time) if isinstance(self.effect, ScannedEffect) else law

    def _scanned(self, setup: ObservingSetup) -> tuple[FloatArray, IntArray]:
        """Return what functions are scanned by, at all times of the observation, and of which each is."""
        return self._candidates(setup).scanned(setup.fitted_jd, setup.observation.times)

    def _functions(self, setup: ObservingSetup) -> FloatArray:
        """Return the functions at all times of the observation, (Ntimes, n); not to be changed."""
        key = ("functions of time", self.time_law)
        if key not in setup.kept:
            setup.kept[key] = self.time_law.over(setup.jd).functions(setup.observation.times)
        known: FloatArray = setup.kept[key]
        return known

    def _at_times(self, setup: ObservingSetup, x: FloatArray, times: Times = EVERY) -> FloatArray:
        """Return the effect's own parameters at times of the observation, (Ntimes, n_params of the effect)."""
        functions, (names, common) = self._functions(setup)[times], self.effect.common_in_time(setup)
        now = functions @ x.reshape(-1, functions.shape[1]).T
        n = now.shape[1] - len(names)
        return now[:, :n] + now[:, n:] @ common

    def _own_parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the parameters of the effect, and what they have in common as elements of its own, n_own."""
        own, (names, common) = self.effect.parameters(setup), self.effect.common_in_time(setup)
        # An effect whose elements are not known yet has nothing in common.
        first = np.argmax(common != 0, axis=1) if len(common) else np.zeros(0, dtype=int)
        units = (*own.units, *(own.units[i] for i in first))
        element = np.concatenate([own.element, own.element.max(initial=-1) + 1 + np.arange(len(names))])
        scale = np.concatenate([own.scale, own.scale[first]])
        of_all = Parameters.of((*own.names, *names), units, scale, element, trials=own.trials + len(names))
        return replace(of_all, sort=None if own.sort is None else np.concatenate([own.sort, own.sort[first]]))

    def _own_columns(self, block: RowBlock, x: FloatArray | None = None) -> Columns:
        """Return the columns of these, where there is nothing yet, or at ``x``, (n_params,)."""
        n, common = len(self.effect.parameters(block.setup)), self.effect.common_in_time(block.setup)[1]
        if self.linear or x is None or not x.any():
            own = self.effect.columns(block, np.zeros(n))
        else:
            if self.displaces_sky:
                # Once for all times, of which each has its part.
                block.integral(self)
            now = self._at_times(block.setup, x, block.times)
            parts = [self.effect.slopes(block.at_time(t), one) for t, one in enumerate(now)]
            own = replace(parts[0], values=np.concatenate([part.values for part in parts]))
        if not len(common):
            return own
        values = np.concatenate([own.values, *(own.apply(one)[..., np.newaxis] for one in common)], axis=-1)
        index = own.index
        if index is not None:
            further = np.broadcast_to(n + np.arange(len(common)), (*index.shape[:-1], len(common)))
            index = np.concatenate([index, further], axis=-1)
        return Columns(values, n + len(common), index, own.by_group)

    def _sums_of_times(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Return Re sum w s* r and sum w |s|^2 of the effect's own columns at each time, (Ntimes, n_own)."""
        own = self._own_columns(block).of_rows(block.member)
        index = np.arange(own.n_params) if own.index is None else own.index
        n_times = len(block.times)
        place = np.arange(n_times)[:, np.newaxis, np.newaxis] * own.n_params + index
        told, power = sums_by(place, own.values, block, n_times * own.n_params)
        return told.reshape(n_times, -1), power.reshape(n_times, -1)


def _several(values: Any) -> Any:
    """Join the last two axes."""
    return values.reshape(*values.shape[:-2], -1)
