"""A rank's rows with the effects of the model removed, and as blocks that effects see."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.accumulate import seen_by
from hydrabeam_mpi.fit.grown import grown_beam
from hydrabeam_mpi.fit.row_model import RowModel
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Active, Estimate
from hydrabeam_mpi.fit.whitening import model_root
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam

ROWS_AT_ONCE = 60_000


class RankData(RowModel):
    """A rank's fitted or held-out rows: what effects and changes of the weights make of them."""

    @cached_property
    def _beams(self) -> dict[int, CoefficientBeam]:
        return {}

    @cached_property
    def _latest(self) -> list[tuple[Estimate, ComplexArray, ComplexArray]]:
        return []

    @cached_property
    def _roots(self) -> dict[int, tuple[Array, bytes, dict[int, FloatArray]]]:
        return {}

    def weighed(self, factor: FloatArray) -> RankData:
        """Return the same rows with weights multiplied by ``factor``, (Nlocal, Ntimes, Nbls).

        What has been worked out of model and sky, which weights do not change, belongs to both.
        """
        _ = self.model, self._plain, self._changed, self.known, self._beams, self._latest
        other = copy(self)
        other.rows = replace(self.rows, inv_noise_var=self.rows.inv_noise_var * factor)
        return other

    def at_times(self, times: IntArray) -> RankData:
        """Return the rows of some times alone, by their numbers in the observation."""
        return RankData(self.problem, self.setup, self.rows.at_times(times), kept_bytes=self.kept_bytes)

    def noise_variance(self, rows: Rows) -> FloatArray:
        """Return the noise's variance by the weights of calibrated rows, in Jy^2 of the data as they were read.

        The result, (Nlocal, Ntimes, Nbls), is zero where rows do not count.
        """
        power: Any = 1.0 if rows.divisor is None else rows.divisor
        read: Any = 1.0 if self.rows.divisor is None else self.rows.divisor
        used = rows.inv_noise_var > 0
        return np.where(used, power / np.where(used, read * rows.inv_noise_var, 1.0), 0.0)

    def row_blocks(
        self, channel: int, at: Estimate, added: ComplexArray, rows: Rows
    ) -> Iterator[tuple[slice, RowBlock, Array]]:
        """Yield blocks of times of one channel with the current model and its design rows.

        Parameters
        ----------
        channel : int
            Among those of the rank group.
        at : Estimate
            The model.
        added : ndarray of complex, (Ntimes, Nbls)
            E of this channel.
        rows : Rows
            Calibrated; see `calibrated`.
        """
        posterior = at.beams[channel]
        times = self.rows.tile.times
        step = times_at_once(len(self.rows.tile.bls))
        held: list[Array] = []
        for t, design in enumerate(self.designs(at.values)):
            held.append(design[channel])
            if len(held) < step and t + 1 < len(times):
                continue
            span = slice(t + 1 - len(held), t + 1)
            # One time, as where there are many baselines, is not copied: its design may be kept already.
            rows_of_design = np.array(held) if len(held) > 1 else held[0][np.newaxis]
            held = []
            beam_alone = seen_by(rows_of_design, posterior.mean)[:, self.rows.member]
            block = self.block(
                channel,
                span,
                self._beam(channel, at),
                at.values,
                vis=beam_alone + added[span],
                weights=rows.inv_noise_var[channel, span],
                residual=rows.data[channel, span] - beam_alone,
                design=rows_of_design,
            )
            yield span, block, rows_of_design

    def model_root(self, channel: int, t: int, at: Estimate, design: Array) -> FloatArray:
        """Return the root of the covariance of predictions of the rank's time number ``t``; see `whitening.model_root`.

        Fits that differ in nothing but what effects add have it in common. It is kept where it takes no more room than
        the design, (Ngroups, n_modes) or its parts.
        """
        posterior, sky = at.beams[channel], self.key_of_sky(at.values)
        if not self.room.designs or 2 * len(self.rows.groups) > design.shape[-1]:
            return model_root(posterior, design)
        kept = self._roots.get(channel)
        if kept is None or kept[0] is not posterior.factor or kept[1] != sky:
            kept = self._roots[channel] = posterior.factor, sky, {}
        if t not in kept[2]:
            kept[2][t] = model_root(posterior, design)
        return kept[2][t]

    def _beam(self, channel: int, at: Estimate) -> CoefficientBeam:
        """Return the mean beam of a channel of the rank group, with all functions that it has got.

        The same object, with its table, for the same beam.
        """
        observation, number = self.problem.observation, int(self.problem.channel_numbers[channel])
        basis, coeffs = grown_beam(self.setup, at.values, number, self.problem.basis, at.beams[channel].mean)
        kept = self._beams.get(channel)
        if kept is not None and np.array_equal(kept.coeffs, coeffs):
            return kept
        info = BeamInfo("inferred", float(observation.freqs[channel]), observation.pols[0])
        self._beams[channel] = CoefficientBeam(basis, coeffs, info)
        return self._beams[channel]

    def effects(self, at: Estimate) -> tuple[ComplexArray, ComplexArray]:
        """Return C and E of all rows, each (Nfreqs, Ntimes, Nbls); those of the latest estimate are kept."""
        if not self._latest or not _same(self._latest[0][0], at):
            others = [one for one in at.values.active if not one.effect.changes_sky]
            self._latest[:] = [(at, *self.effects_of(at, others))]
        return self._latest[0][1:]

    def effects_of(
        self, at: Estimate, others: Sequence[Active], only: int | None = None
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return C and E, (Nlocal, Ntimes, Nbls) each, of some of the effects, none of which changes the sky.

        They are one and zero but in the channel ``only``, where one is given.
        """
        factor = np.ones(self.rows.data.shape, dtype=complex)
        added = np.zeros_like(factor)
        for channel, number in enumerate(self.problem.channel_numbers.tolist() if others else ()):
            if only not in (None, channel):
                continue
            for span, block, _ in self.row_blocks(channel, at, added[channel], self.rows):
                for one in others:
                    if one.effect.multiplies:
                        factor[channel, span] *= one.effect.factor(block, one.x[number])
                    else:
                        added[channel, span] += block.added_by(one.effect, one.x[number])
        return factor, added

    def calibrated(
        self, at: Estimate, effects: tuple[ComplexArray, ComplexArray] | None = None
    ) -> tuple[Rows, ComplexArray]:
        """Return the rows with the effects removed, d/C - E with weights w |C|^2, and E, (Nfreqs, Ntimes, Nbls).

        C and E are those of the `effects` if they are known already.
        """
        factor, added = effects or self.effects(at)
        power = np.abs(factor) ** 2
        usable = power > 1e-12
        data = np.where(usable, self.rows.data / np.where(usable, factor, 1.0), 0.0) - added
        weights = np.where(usable, self.rows.inv_noise_var * power, 0.0)
        divisor = power if self.rows.divisor is None else power * self.rows.divisor
        rows = replace(self.rows, data=data, inv_noise_var=weights, divisor=divisor)
        if at.values.reweighted:
            weights = rows.inv_noise_var.copy()
            for channel, number in enumerate(self.problem.channel_numbers.tolist()):
                for span, block, _ in self.row_blocks(channel, at, added[channel], rows):
                    for one in at.values.reweighted:
                        # One after the other: a threshold is about weights that the others have changed already.
                        factor_of_one = one.change.weight_factor(block, one.x[number])
                        block = replace(block, weights=block.weights * factor_of_one)
                    weights[channel, span] = block.weights
            rows = replace(rows, inv_noise_var=weights)
        return rows, added


def times_at_once(n_bls: int) -> int:
    """Return how many times a block of so many baselines has."""
    return max(1, ROWS_AT_ONCE // max(n_bls, 1))


def _same(one: Estimate, two: Estimate) -> bool:
    """Whether two estimates have the same effects with the same parameters, and the same beams."""
    pairs = zip(one.values.active, two.values.active, strict=False)
    return (
        len(one.values.active) == len(two.values.active)
        and len(one.beams) == len(two.beams)
        and all(first.effect is second.effect and np.array_equal(first.x, second.x) for first, second in pairs)
        and all(np.array_equal(first.mean, second.mean) for first, second in zip(one.beams, two.beams, strict=True))
    )
