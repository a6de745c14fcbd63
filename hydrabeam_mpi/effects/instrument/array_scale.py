"""An array that is larger, or smaller, than stated, in wavelengths: wrong units of positions, or wrong frequencies."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.displaced import TURNED_SKY, need_real_beam, stretch_rate, turning_columns

Wrong = Literal["positions", "frequencies"]
PERCENT, KHZ = 0.01, 1e3


class ArrayScale(Effect):
    """Baselines, in wavelengths, are all longer or shorter than stated by the same factor.

    Either the positions of the antennas are too far apart, in all channels alike, or all channels are at frequencies
    higher than stated by the same number of Hz, which counts more where these are low. A single channel does not tell
    one from the other. Fluxes and beam are those of the stated frequencies: the beam is fitted anyway.

    Parameters
    ----------
    wrong : {"positions", "frequencies"}
        What is not as stated.
    """

    kind = "array_scale"
    title = "scale of the array"
    of_both_feeds = True
    shared = True

    def __init__(self, wrong: Wrong = "positions") -> None:
        self.wrong = wrong

    def describe(self) -> dict[str, Any]:
        """Return what is not as stated."""
        return {"wrong": self.wrong}

    def variants(self, setup: ObservingSetup) -> list[Effect]:
        """Return the other one of the two, where channels tell them apart."""
        if setup.observation.Nfreqs == 1:
            return []
        return [ArrayScale(wrong) for wrong in get_args(Wrong) if wrong != self.wrong]

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the same as is in the model."""
        return newest if isinstance(newest, ArrayScale) and newest.wrong != self.wrong else self

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams."""
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return by how much baselines in wavelengths are longer than stated, at the mean frequency."""
        return Parameters.of(["baselines longer than stated"], "%", 0.1)

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return the same, or by how much frequencies are higher; with one channel it is said that it is either."""
        name, unit, per_percent = "baselines longer than stated", "%", 1.0
        if self.wrong == "frequencies":
            name, unit, per_percent = "frequencies higher than stated", "kHz", PERCENT * setup.reference_freq / KHZ
        elif setup.observation.Nfreqs == 1:
            name = "baselines longer, or the frequency higher, than stated"
        return Told((name,), (unit,), per_percent * x, per_percent * std, np.ones(1, dtype=bool))

    @property
    def integrated_as(self) -> str:
        """The name of what is needed as well by all that turns the sky."""
        return TURNED_SKY

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the `turning_columns`, (7, Nsrc)."""
        return turning_columns(sources)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what stretching the baselines further does, (Ntimes, Ngroups, 1); ``x`` is (n_params,)."""
        moments = block.integral(self)
        if x.any():
            moments = block.integrate(self.sky_columns, vectors=self._stretched(block, x))
        # Of the stated vectors, by which they get longer however long they are.
        rates = stretch_rate(block, moments[..., 1:4])
        return Columns(self._per_percent(block) * rates[..., np.newaxis], 1, by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the visibilities on the true baselines minus those on the stated ones, (Ntimes, Nbls)."""
        if not x.any():
            return np.zeros(block.shape, dtype=complex)
        vectors = self._stretched(block, x)
        after = block.integrate(lambda sources: sources.exact_beam[np.newaxis], vectors=vectors)
        return block.spread(after[..., 0] - block.integral(self)[..., 0])

    def _stretched(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the true vectors of the block's groups, (Ngroups, 3), metres ENU at the stated frequency."""
        return np.asarray((1 + self._per_percent(block) * x[0]) * block.vectors)

    def _per_percent(self, block: RowBlock) -> float:
        """Return by which part of their length the block's baselines are longer, for one per cent at the mean."""
        return PERCENT * (block.setup.reference_freq / block.freq if self.wrong == "frequencies" else 1.0)
