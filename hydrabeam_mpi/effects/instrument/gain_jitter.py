"""Gains that jitter: g_j(t) = exp(a_j(t) + i phi_j(t)) with a value of its own at each integration.

What one integration has says nothing of the next, so that there is no law in time but how large it all is: the prior's
width, which the evidence finds. Receivers do that whose reference is unsteady, and gains that were solved for
integration by integration, whose noise stays in the data.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal, Self

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect, sums_by
from hydrabeam_mpi.effects.shared.in_time import InTime
from hydrabeam_mpi.effects.shared.per_antenna import (
    antennas_named,
    logarithm_of,
    product_of_gains,
    without_whole_turns,
)
from hydrabeam_mpi.effects.shared.time_laws import Piecewise, Smooth
from hydrabeam_mpi.eigen import IN_A_SECOND
from hydrabeam_mpi.errors import InputError

Part = Literal["ln amplitude", "phase"]
UNITS: dict[Part, str] = {"ln amplitude": "", "phase": "rad"}
PARTS = tuple(UNITS)
BY_PART = np.array([1, 1j])
MOST_TIMES = 600
"""Integrations at most, of which an amplitude or a phase has a parameter each. That is about time alone: products of so
many columns take as long as those of all other effects together."""
MOST_COLUMNS = IN_A_SECOND
"""Parameters that are weighed together, of which a visibility has no more than four, so that their sums take little.
They are ten antennas in fifty integrations; all that jitter have to be in the model before a drift, or anything else,
can be told from what they leave."""


class GainJitter(ScannedEffect):
    """Amplitudes or phases of the gains of some antennas, anew at each integration and in each channel.

    An unsteady reference has phases alone, so that an antenna's amplitude and its phase are candidates of their own.

    Parameters
    ----------
    gains_of : sequence of (int, {"ln amplitude", "phase"})
        Numbers of antennas, and what of their gains jitters; none for an effect that is to be scanned.
    """

    kind = "gain_jitter"
    title = "antenna gains that jitter"
    local = "times"
    linear = True
    multiplies = True

    def __init__(self, gains_of: Sequence[tuple[int, Part]] = ()) -> None:
        self.gains_of = tuple((int(number), part) for number, part in gains_of)

    def describe(self) -> dict[str, Any]:
        """Return the antennas, and what of their gains it is."""
        return {"gains_of": [[number, part] for number, part in self.gains_of]}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several times, and for no more than can be weighed."""
        fitted, n_times = len(setup.fitted_jd), len(setup.times)
        if fitted < 2:
            return f"what differs from time to time needs several fitted times; there are {fitted}"
        if n_times > MOST_TIMES:
            return f"it has a parameter for each of {n_times} integrations; {MOST_TIMES} at most are looked at"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the ln amplitude or phase of each at each time in use."""
        jds = setup.observation.times[setup.times]
        names = [f"antenna {number} {part} at JD {jd:.5f}" for number, part in self.gains_of for jd in jds]
        units = [UNITS[part] for _, part in self.gains_of for _ in jds]
        element = np.repeat(np.arange(len(self.gains_of)), len(jds))
        return Parameters.of(names, units, 0.01, element, trials=self.n_hypotheses(setup))

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the phase that all antennas have in common at each time, (n_directions, n_params)."""
        n_times, phases = len(setup.times), np.array([part == "phase" for _, part in self.gains_of])
        if np.count_nonzero(phases) < len(setup.antennas_in_use):
            return np.zeros((0, len(phases) * n_times))
        return np.asarray(np.kron(phases / np.sqrt(np.count_nonzero(phases)), np.eye(n_times)))

    def carried_over(self, setup: ObservingSetup) -> Self:
        """Return the effect of those antennas that other data have: what was found of a time holds at that time."""
        here = setup.observation.antenna_numbers.tolist()
        return type(self)([one for one in self.gains_of if one[0] in here])

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return all of it as gains that jump, and as gains that drift: a law has fewer numbers than there are times.

        Each is about levels of its own. Only fitted times in use tell what it is, and of phases no whole turns.
        """
        (places, parts), rows = self._places(setup), self._by_time(setup, x.mean(axis=0), std.mean(axis=0))
        drift = Smooth().over(setup.jd).candidates(setup.fitted_jd, setup.jd).with_level()
        jumps = Piecewise().over(setup.jd).candidates(setup.fitted_jd, setup.jd).with_level()
        jumps = jumps.at([one for row in rows for one in jumps.wanted_by(*row)])
        own = len(PARTS) * np.searchsorted(setup.antennas_in_use, places) + parts
        found: list[tuple[BoolArray, Effect, FloatArray]] = []
        for law in [*([jumps] if jumps.jumps else []), drift]:
            effect, names = InTime(AntennaGains(), law), law.names()
            begun = np.zeros(len(effect.parameters(setup)))
            for first, row in zip(len(names) * own, rows, strict=True):
                begun[first : first + len(names)] = law.numbers(*row)
            found.append((np.ones(x.shape[1], dtype=bool), effect, begun))
        return found

    def _by_time(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Return the fitted times in use of each amplitude or phase, JD, with values and errors there, (Ntimes,) each.

        Phases go on from time to time by less than half a turn.
        """
        jd, shape = setup.observation.times[setup.times], (len(self.gains_of), len(setup.times))
        is_fitted = np.isin(setup.times, setup.times if setup.fitted is None else setup.fitted)
        rows = list[tuple[FloatArray, FloatArray, FloatArray]]()
        for (_, part), values, errors in zip(self.gains_of, x.reshape(shape), std.reshape(shape), strict=True):
            known = is_fitted & (errors > 0)
            there = values[known]
            rows.append((jd[known], np.asarray(np.unwrap(there)) if part == "phase" else there, errors[known]))
        return rows

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return m or i m for the first antenna of a row, m or -i m for the second; ``x`` is (n_params,)."""
        n, n_times = len(self.gains_of), len(block.setup.times)
        if not n:
            return Columns(np.zeros((*block.shape, 0), dtype=complex), 0)
        places, parts = self._places(block.setup)
        element = np.full((block.setup.observation.Nants, len(PARTS)), -1)
        element[places, parts] = np.arange(n)
        ends = element[np.stack([block.ant1, block.ant2], axis=1)]  # (Nbls, 2, 2)
        by_end = np.where(ends >= 0, np.stack([BY_PART, BY_PART.conj()]), 0)
        values = block.vis[..., np.newaxis, np.newaxis] * by_end
        time = block.places_in_time[:, np.newaxis, np.newaxis, np.newaxis]
        index = n_times * np.maximum(ends, 0) + time
        shape = (*block.shape, ends[0].size)
        return Columns(values.reshape(shape), n * n_times, index.reshape(shape))

    def begun(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the logarithms of the gains 1 + x_0 + i x_1 that were found, (..., n_params)."""
        places, parts = self._places(setup)
        of_antennas = np.array([self._of_antennas(setup, one) for one in np.atleast_2d(x)])
        ln = logarithm_of(1 + of_antennas[..., places].swapaxes(1, 2))
        return np.asarray(np.where(parts[:, np.newaxis] == 0, ln.real, ln.imag).reshape(x.shape))

    def needed_at(self, setup: ObservingSetup, x: FloatArray) -> tuple[Effect, IntArray, BoolArray]:
        """Return the effect with the phases of antennas whose signs are lost, at the times at which they are."""
        n_times, rows = len(setup.times), x.reshape(-1, len(self.gains_of), len(setup.times))
        lost: dict[tuple[int, Part], BoolArray] = {
            (number, "phase"): at_times
            for (number, part), at_times in zip(self.gains_of, np.any(rows < -1, axis=0), strict=True)
            if part == "ln amplitude" and at_times.any()
        }
        more = type(self)([*self.gains_of, *(one for one in lost if one not in self.gains_of)])
        needed = np.array([lost.get(one, np.zeros(n_times, dtype=bool)) for one in more.gains_of]).reshape(-1)
        needed[: x.shape[-1]] &= ~np.any(rows, axis=0).reshape(-1)
        return more, np.arange(x.shape[-1]), needed

    def without_turns(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the parameters with phases from -pi to pi, (..., n_params)."""
        is_phase = np.repeat([part == "phase" for _, part in self.gains_of], len(setup.times))
        return np.where(is_phase, without_whole_turns(x), x)

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return g_j g_k*, (Ntimes, Nbls)."""
        ln = self._of_antennas(block.setup, x)[block.places_in_time]
        return product_of_gains(ln[:, block.ant1], ln[:, block.ant2])

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return exp(a + i phi), (Ntimes, Nants); one at times that are not in use."""
        gains = np.ones((setup.observation.Ntimes, setup.observation.Nants), dtype=complex)
        gains[setup.times] = np.exp(self._of_antennas(setup, x))
        return gains

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of amplitudes and phases."""
        return len(PARTS) * len(setup.antennas_in_use)

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Return the sums for the amplitude and the phase of every antenna at each time, (n_hypotheses, Ntimes)."""
        columns = self._all(block.setup).columns(block, np.zeros(0))
        assert columns.index is not None
        scores, norms = sums_by(columns.index, columns.values, block, columns.n_params)
        shape = (self.n_hypotheses(block.setup), -1)
        return scores.reshape(shape), norms.reshape(shape)

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> Self:
        """Return the effect with the first of these, (Nchosen,), as many as are weighed together."""
        most, known = max(MOST_COLUMNS // len(setup.times), 1), self._all(setup).gains_of
        return type(self)([known[one] for one in np.asarray(hypotheses)[:most]])

    def _all(self, setup: ObservingSetup) -> Self:
        """Return the effect with the amplitudes and phases of all antennas."""
        numbers = setup.observation.antenna_numbers[setup.antennas_in_use].tolist()
        return type(self)([(number, part) for number in numbers for part in PARTS])

    def _places(self, setup: ObservingSetup) -> tuple[IntArray, IntArray]:
        """Return the index of each antenna, and which part of its gain it is, (n,) each.

        Raises
        ------
        InputError
            If the observation lacks an antenna, or one is named twice.
        """
        (number, part), times = max(Counter(self.gains_of).items(), key=lambda one: one[1], default=((0, ""), 0))
        if times > 1:
            raise InputError(f"antenna {number} {part} is named twice", field="gains_of", remedy="name each once")
        parts = np.array([PARTS.index(part) for _, part in self.gains_of], dtype=int)
        return antennas_named(setup, [number for number, _ in self.gains_of], "gains_of"), parts

    def _of_antennas(self, setup: ObservingSetup, x: FloatArray) -> ComplexArray:
        """Return x_0 + i x_1 of all antennas of the observation at the times in use, (Ntimes, Nants)."""
        places, parts = self._places(setup)
        own = np.zeros((len(PARTS), setup.observation.Nants, len(setup.times)))
        own[parts, places] = x.reshape(len(places), len(setup.times))
        return np.asarray((own[0] + 1j * own[1]).T)
