"""Smearing: visibilities that are means over an integration, in which the sky turns, and over a channel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import spherical_jn

from hydrabeam_mpi.data.observation import C_M_PER_S, EARTH_RATE, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.displaced import (
    need_real_beam,
    rotate,
    turn_per_second,
    turned_sky,
    turning_columns,
    turning_rates,
)
from hydrabeam_mpi.model.engines.gemm import GemmEngine
from hydrabeam_mpi.model.engines.smearing import Smearing as FringeMeans
from hydrabeam_mpi.model.engines.smearing import mean_steps

Axis = Literal["time", "frequency"]
MEANS: dict[Axis, tuple[str, str, str]] = {
    "time": ("square of the integrations' length", "integrations are means over", "s"),
    "frequency": ("square of the channels' width", "channels are means over", "MHz"),
}
"""What its parameter is called, what people are told, and in which unit its root is."""
HZ = 1e6  # in the unit of the parameter
SHORT = 0.1
"""Of what the data state: shorter means lose in proportion to the square of their length, to 1e-4 of what is lost as
long as what is stated loses a few percent."""
STEP = 3e-4
"""Radians, of numerical second derivatives of beams."""


class ChannelMeans(FringeMeans):
    """Fringes as means over a channel, of a width in MHz."""

    def __init__(self, width: float) -> None:
        super().__init__(turn=(0.0, 0.0, 0.0), bandwidth=width * HZ)


class SlopeOfChannelMeans(ChannelMeans):
    """Their derivatives by the square of the width, MHz^2, in the place of the fringes themselves."""

    def left(self, vectors: FloatArray, directions: FloatArray, freq: float) -> FloatArray:
        """Return the derivative of sin(x) / x, (Nvectors, Nsrc), where the fringe turns by 2 x over the channel."""
        x = (np.pi * self.bandwidth / C_M_PER_S * vectors) @ directions
        # x d/dx of it is -x j_1(x), of the spherical Bessel function.
        return np.asarray(-x * spherical_jn(1, x) / (2 * (self.bandwidth / HZ) ** 2))


@dataclass(frozen=True)
class Smearing(Effect):
    """Means over time and over frequency, each of one length for all data, where the model has instants.

    Sources are lost the more the faster a baseline's fringe turns across them. A mean over T loses in proportion to T^2
    at first, so that this is the parameter. Over an integration the whole sky turns, through the beam and the horizon.

    Attributes
    ----------
    over : tuple of {"time", "frequency"}
        What the means are over.
    """

    over: tuple[Axis, ...] = ("time", "frequency")

    kind = "smearing"
    title = "smearing by integrations and channels"
    of_both_feeds = True
    shared = True
    unphysical = "negative length"

    def describe(self) -> dict[str, Any]:
        """Return what the means are over."""
        return {"over": list(self.over)}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams, and data whose means the model has already."""
        if setup.observation.is_smeared:
            return "[data] smearing has the model's visibilities as such means already"
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the squares of the lengths, each an element; the scales are those that the data state."""
        observation = setup.observation
        stated = {"time": observation.integration_time.mean(), "frequency": observation.channel_width.mean() / HZ}
        return Parameters.of(
            [MEANS[axis][0] for axis in self.over],
            [f"{MEANS[axis][2]}^2" for axis in self.over],
            np.array([stated[axis] ** 2 for axis in self.over]),
            np.arange(len(self.over)),
        )

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw squares, which are positive, (n_params,)."""
        return np.abs(super().draw(setup, rng, strength))

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the beam, (1, Nsrc)."""
        return _beam(sources)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the derivatives by the squares, of which E is taken as an odd function; ``x`` is (n_params,)."""
        lengths = np.sqrt(np.abs(x))
        is_short = lengths < SHORT * np.sqrt(self.parameters(block.setup).scale)
        at_zero = dict(zip(MEANS, _slopes_at_zero(block), strict=True)) if is_short.any() else {}
        values = [
            at_zero[axis] if short else _slope(block, axis, length)
            for axis, short, length in zip(self.over, is_short.tolist(), lengths.tolist(), strict=True)
        ]
        return Columns(np.stack(values, axis=-1), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the means minus what instants and frequencies have, (Ntimes, Nbls); each mean by itself."""
        change = np.zeros((len(block.times), len(block.groups)), dtype=complex)
        for axis, square in zip(self.over, x.tolist(), strict=True):
            if square:
                mean = _mean(block, axis, float(np.sqrt(abs(square))))
                change += np.sign(square) * (mean - block.integral(self)[..., 0])
        return block.spread(change)

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return the lengths themselves."""
        length = np.sign(x) * np.sqrt(np.abs(x))
        # The error of a root; of what is zero within its error, the root of that.
        error = 0.5 * np.divide(std, np.sqrt(np.maximum(np.abs(x), std / 4)), out=np.zeros_like(std), where=std > 0)
        names, units = (tuple(MEANS[axis][n] for axis in self.over) for n in (1, 2))
        return Told(names, units, length, error, np.ones(len(self.over), dtype=bool))

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Return by how many standard errors squares are below zero, (n_params,)."""
        return sigmas(-x, std).max(axis=0)

    def without(self, gone: BoolArray) -> tuple[Smearing, IntArray]:
        """Return the other mean, if one is left."""
        left = np.flatnonzero(~gone)
        return Smearing(tuple(self.over[number] for number in left.tolist())), left


def _later(block: RowBlock, seconds: float) -> RowBlock:
    """Return the block with the sky as it is some seconds later."""
    if not seconds:
        return block
    return turned_sky(block, seconds * turn_per_second(block))


def _in_time(block: RowBlock, seconds: float) -> list[tuple[float, float]]:
    """Return steps from the middle of a mean over time, in lengths of it, with their weights."""
    return mean_steps(block.vectors, seconds * EARTH_RATE * block.freq / C_M_PER_S)


def _mean(block: RowBlock, axis: Axis, length: float) -> ComplexArray:
    """Return the visibilities as means over a length, (Ntimes, Ngroups)."""
    if axis == "frequency":
        return _with_fringes(block, ChannelMeans(length))
    total: Any = 0.0
    for step, weight in _in_time(block, length):
        total = total + weight * _later(block, step * length).integrate(_beam)[..., 0]
    return np.asarray(total)


def _with_fringes(block: RowBlock, fringes: ChannelMeans) -> ComplexArray:
    """Return the visibilities of other fringes, (Ntimes, Ngroups)."""
    engine = GemmEngine(block.vectors)
    engine.smearing = fringes
    return np.asarray(block.integrate(_beam, engine=engine)[..., 0])


def _slope(block: RowBlock, axis: Axis, length: float) -> ComplexArray:
    """Return the derivative of `_mean` by the square of the length, (Ntimes, Ngroups)."""
    if axis == "frequency":
        return _with_fringes(block, SlopeOfChannelMeans(length))
    total: Any = 0.0
    for step, weight in _in_time(block, length):
        rates = turning_rates(block, _later(block, step * length).integrate(turning_columns))
        total = total + weight * step * (rates @ turn_per_second(block))
    return np.asarray(total / (2 * length))


def _slopes_at_zero(block: RowBlock) -> tuple[ComplexArray, ComplexArray]:
    """Return the derivatives by the squares of lengths that are zero, over time and frequency, (Ntimes, Ngroups) each.

    That is a 24th of the second derivatives of what is seen at an instant and a frequency.
    """
    turn = turn_per_second(block)
    one, two = np.triu_indices(3)

    def columns(sources: Sources) -> FloatArray:
        """Return what goes with no, one and two baseline vectors by time, and with two by frequency, (16, Nsrc)."""
        s, beam = sources.enu, sources.exact_beam
        angle = STEP / np.linalg.norm(turn)
        before, after = (sources.beam_at(rotate(s, sign * angle * turn)) for sign in (-1, 1))
        slope, bend = (after - before) / (2 * angle), (after - 2 * sources.beam + before) / angle**2
        moved = np.cross(turn, s, axis=0)
        moved_on = np.cross(turn, moved, axis=0)
        parts = (bend[np.newaxis], 2 * slope * moved + beam * moved_on, beam * moved[one] * moved[two])
        return np.concatenate([*parts, beam * s[one] * s[two]])

    moments = block.integrate(columns)
    wavenumber = 2 * np.pi * block.freq / C_M_PER_S
    vectors = wavenumber * block.vectors
    products = vectors[:, one] * vectors[:, two] * np.where(one == two, 1.0, 2.0)
    by_one = np.einsum("tgk,gk->tg", moments[..., 1:4], vectors)
    by_two, in_channel = (np.einsum("tgk,gk->tg", moments[..., part], products) for part in (np.s_[4:10], np.s_[10:]))
    in_time = moments[..., 0] + 1j * by_one - by_two
    return np.asarray(in_time / 24), np.asarray(-in_channel * (HZ / block.freq) ** 2 / 24)


def _beam(sources: Sources) -> FloatArray:
    """Return the beam as a column, (1, Nsrc)."""
    return sources.exact_beam[np.newaxis]
