"""Ionospheric refraction in bulk: the whole sky is shifted by an angle proportional to the wavelength squared.

Sources at the zenith move by the whole of it. What it is away from there depends on what does it, and the fit tells
which explains the data best: the sky turns as a whole ("turn"), as for a clock or a pole that are wrong; direction
cosines shift alike ("flat"), as by a gradient of phase over the array; or by as much more as the path is longer
through a thin shell with a gradient of its electrons ("shell").
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.displaced import ARCMIN, TILTS, TurningSky, rotation_rate
from hydrabeam_mpi.effects.shared.in_time import InTime
from hydrabeam_mpi.effects.shared.shifted import (
    Path,
    ShiftedPositions,
    flat_path,
    shell_path,
    shifting_columns,
    shifting_rates,
)
from hydrabeam_mpi.effects.shared.time_laws import Smooth
from hydrabeam_mpi.model.positions import SourcePositions

Away = Literal["turn", "flat", "shell"]
PATHS: dict[str, Path] = {"flat": flat_path, "shell": shell_path}


class Refraction(TurningSky):
    """All sources are seen shifted towards East and North, by angles that go as lambda^2.

    Parameters
    ----------
    away : {"turn", "flat", "shell"}
        Away from the zenith.
    """

    kind = "ionosphere"
    title = "ionospheric refraction"
    laws: ClassVar = {
        "smooth": "ionospheric refraction that drifts",
        "nightly": "ionospheric refraction that drifts anew each night",
    }
    of_the_sky = True

    def __init__(self, away: Away = "turn") -> None:
        self.away = away

    @abstractmethod
    def in_arcmin(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the shifts of each of the block's times at the reference frequency, arcmin, (Ntimes, 2)."""

    def describe(self) -> dict[str, Any]:
        """Return what the shift is away from the zenith."""
        return {"away": self.away}

    def elsewhere(self) -> list[Self]:
        """Return the same with the other ways that shifts go away from the zenith."""
        return [type(self)(away) for away in get_args(Away) if away != self.away]

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return what is needed of the sky to turn it, (7, Nsrc), or to shift it, (6, Nsrc)."""
        return super().sky_columns(sources) if self.away == "turn" else shifting_columns(sources, PATHS[self.away])

    @property
    def integrated_as(self) -> str:
        """The name of what its way of shifting needs."""
        return super().integrated_as if self.away == "turn" else f"{self.away} shift of the sky"

    def rotations(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the rotation of each time at the block's frequency, (Ntimes, 3)."""
        return np.asarray(self._shifts(block, x) @ TILTS.T)

    def displaced(self, block: RowBlock, x: FloatArray) -> SourcePositions:
        """Return the places of the sky that is turned or shifted."""
        if self.away == "turn":
            return super().displaced(block, x)
        shifts = dict(zip(block.times.tolist(), self._shifts(block, x), strict=True))
        return ShiftedPositions(block.positions, shifts, PATHS[self.away])

    def rates_by_shift(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return how visibilities change as the shifts of their times grow by an arcmin, (Ntimes, Ngroups, 2).

        The block's sky is shifted by ``x``.
        """
        if self.away == "turn":
            rates = self.rates(block) @ np.array([rotation_rate(one) @ TILTS for one in self.rotations(block, x)])
        else:
            rates = shifting_rates(block, block.integral(self))
        return np.asarray(self._per_arcmin(block) * rates)

    def _shifts(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the shifts of each time at the block's frequency, radians at the zenith, (Ntimes, 2)."""
        return np.asarray(self._per_arcmin(block) * self.in_arcmin(block, x))

    @staticmethod
    def _per_arcmin(block: RowBlock) -> float:
        """Return the shift at the block's frequency, in radians, that is one arcmin at the reference frequency."""
        return ARCMIN * (block.setup.reference_freq / block.freq) ** 2


class Ionosphere(Refraction):
    """Shifts towards East and North at the mean frequency of the channels, others at each time, or that drift.

    Parameters
    ----------
    away : {"turn", "flat", "shell"}
        Away from the zenith.
    """

    local = "times"

    def changing(self, law: Smooth) -> DriftingRefraction:
        """Return what drifts: the same two shifts at all times, with functions of these."""
        return DriftingRefraction(SteadyRefraction(self.away), law)

    def variants(self, setup: ObservingSetup) -> list[Effect]:
        """Return the other ways that shifts go away from the zenith."""
        return [*self.elsewhere()]

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the same as is in the model."""
        return newest if isinstance(newest, Ionosphere) and newest.away != self.away else self

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the shifts towards East and North at the reference frequency, for each time in use."""
        n_times = len(setup.times)
        jds = setup.observation.times[setup.times]
        names = [f"shift towards {where} at JD {jd:.5f}" for jd in jds for where in ("East", "North")]
        return Parameters.of(names, "arcmin", 1.0, np.repeat(np.arange(n_times), 2))

    def in_arcmin(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the shifts of each of the block's times, (Ntimes, 2)."""
        return x.reshape(-1, 2)[block.places_in_time]

    def slopes(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what small further shifts of a time do to it; ``x`` is (n_params,)."""
        index = 2 * block.places_in_time[:, np.newaxis, np.newaxis] + np.arange(2)
        return Columns(self.rates_by_shift(block, x), 2 * len(block.setup.times), index, by_group=True)


class SteadyRefraction(Refraction):
    """Refraction that is the same at all times.

    By itself it is no candidate: in one channel it is a sky that is turned.
    """

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the shifts towards East and North at the reference frequency, which are wanted together."""
        return Parameters.of([f"shift towards {where}" for where in ("East", "North")], "arcmin", 1.0, [0, 0])

    def in_arcmin(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the shifts of each of the block's times, (Ntimes, 2)."""
        return np.tile(x, (len(block.times), 1))

    def slopes(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what small further shifts do, (Ntimes, Ngroups, 2); ``x`` is (n_params,)."""
        return Columns(self.rates_by_shift(block, x), 2, by_group=True)


class DriftingRefraction(InTime):
    """Refraction that drifts, with a level: a gradient of electrons that comes and goes has no reason to be even.

    Parameters
    ----------
    effect : SteadyRefraction
    law : Smooth
    """

    effect: SteadyRefraction
    time_law: Smooth

    def variants(self, setup: ObservingSetup) -> list[Effect]:
        """Return the other ways that shifts go away from the zenith."""
        return [type(self)(one, self.time_law) for one in self.effect.elsewhere()]

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the same as is in the model."""
        if not isinstance(newest, DriftingRefraction) or newest.effect.away == self.effect.away:
            return self
        return type(self)(newest.effect, self.time_law)

    def _candidates(self, setup: ObservingSetup) -> Smooth:
        """Return the law with the functions that are looked at."""
        return self.time_law.over(setup.jd).candidates(setup.fitted_jd, setup.jd).with_level()
