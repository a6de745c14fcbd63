"""Saturation: gains g = 1 - sum_k c_k q_k(P(t)) that fall with powers of the total power P that antennas measure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.compression import usual_powers
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.per_antenna import antennas_named, row_antennas

ALL = "all"
ORDERS = 3
"""Of polynomials in the power: what an amplifier loses near its limit grows faster than in proportion to it."""


class Saturation(Effect):
    """How much of the gain is lost in proportion to three polynomials of the total power.

    Of all antennas, and of each beyond that. The power is the median autocorrelation that the files have, in which
    there is all that comes in: the receivers' own noise, and a galaxy that a catalogue of sources lacks. Without
    autocorrelations it is what the model beam sees of the sky model. The q_k are combinations of P, P^2 and P^3, so
    that nothing is lost where nothing comes in; over the times in use they are orthogonal, with an rms of one. An
    amplifier near its limit loses gain, and no more than all: the loss in proportion to P is between 0 and 1.

    Parameters
    ----------
    losses_of : sequence of int or "all", optional
        Numbers of antennas whose losses beyond those of all are looked for, and "all" for the latter; by default all of
        these.
    """

    kind = "saturation"
    title = "gains that saturate with the total power"
    multiplies = True
    unphysical = "gains that grow with the power, or none left"

    def __init__(self, losses_of: Sequence[int | str] | None = None) -> None:
        self.losses_of = None if losses_of is None else tuple(one if one == ALL else int(one) for one in losses_of)

    def describe(self) -> dict[str, Any]:
        """Return whose losses are looked for."""
        return {} if self.losses_of is None else {"losses_of": list(self.losses_of)}

    def sought_in(self, setup: ObservingSetup) -> Saturation:
        """Return the losses of all antennas and of each that is in use, of which some may be left out."""
        return Saturation(self._whose(setup))

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for equal feeds, and for as many times as there are polynomials."""
        if not setup.observation.is_copolar:
            return "the power that saturates is that of equal feeds, such as 'ee'; there is none of these"
        if len(setup.times) < ORDERS:
            return f"a curve of the power shows only at {ORDERS} times or more; there are {len(setup.times)}"
        return None

    def carried_over(self, setup: ObservingSetup) -> str:
        """Say that other data have another range of powers, over which the polynomials are others."""
        return "its curves are over the powers of the data that it was found in"

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return what all antennas have in common, and what each has beyond that: elements of three orders each."""
        whose = ["all antennas" if one == ALL else f"antenna {one} beyond that" for one in self._whose(setup)]
        names = [f"{one}, loss of order {order + 1} in the power" for one in whose for order in range(ORDERS)]
        return Parameters.of(names, "", 0.01, np.repeat(np.arange(len(whose)), ORDERS))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw losses, which are positive in proportion to the power, (n_params,)."""
        drawn = super().draw(setup, rng, strength)
        drawn[::ORDERS] = np.abs(drawn[::ORDERS])
        return drawn

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the common part that single antennas take back, of each order, (n_directions, n_params)."""
        n, places = len(setup.antennas_in_use), self._places(setup)
        if len(places) <= n:
            return np.zeros((0, len(places) * ORDERS))
        return np.kron(np.where(places == 0, 1.0, -1.0), np.eye(ORDERS)) / np.sqrt(n + 1)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return -q_k/g m for a row's two antennas together and by themselves; ``x`` is (n_params,)."""
        curves, gains = self._gains(block, x)
        each = -curves[:, np.newaxis, np.newaxis] / gains[..., np.newaxis]
        by_whom = np.concatenate([each.sum(axis=2, keepdims=True), each], axis=2)
        antennas = row_antennas(block) + 1
        whose = np.concatenate([np.zeros_like(antennas[:, :1]), antennas], axis=1)
        own = np.full(len(block.setup.antennas_in_use) + 1, -1)
        places = self._places(block.setup)
        own[places] = np.arange(len(places))
        by_whom = np.where((own[whose] >= 0)[..., np.newaxis], by_whom, 0.0)
        index = (ORDERS * np.maximum(own[whose], 0)[..., np.newaxis] + np.arange(ORDERS)).reshape(len(whose), -1)
        values = block.vis[..., np.newaxis] * by_whom.reshape(*by_whom.shape[:2], -1)
        return Columns(values, len(x), index)

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return g_j g_k, (Ntimes, Nbls)."""
        return self._gains(block, x)[1].prod(axis=2).astype(complex)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return the gains of all antennas, (Ntimes, Nants); one at times, and of antennas, that are not in use."""
        gains = np.ones((setup.observation.Ntimes, setup.observation.Nants), dtype=complex)
        losses = self._of_all(setup, x)
        gains[np.ix_(setup.times, setup.antennas_in_use)] -= _curves(setup, channel) @ (losses[0] + losses[1:]).T
        return gains

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Return by how many standard errors losses in proportion to the power are below 0 or above 1, (n_params,).

        An antenna's is that of all and its own together.
        """
        places, first = self._places(setup), slice(None, None, ORDERS)
        loss, error = x[:, first].copy(), std[:, first] ** 2
        # What all have in common may have been left out.
        for part in (loss, error):
            part[:, places > 0] += part[:, places == 0].sum(axis=1, keepdims=True)
        error = np.where(std[:, first] > 0, np.sqrt(error), 0.0)
        beyond = np.maximum(sigmas(-loss, error), sigmas(loss - 1, error)).max(axis=0, initial=0.0)
        return np.repeat(beyond, ORDERS)

    def without(self, gone: BoolArray) -> tuple[Saturation, IntArray]:
        """Return the losses of the others that are left, of what was `sought_in` a setup."""
        assert self.losses_of is not None
        left = np.flatnonzero(~gone.reshape(-1, ORDERS).any(axis=1))
        numbers = (ORDERS * left[:, np.newaxis] + np.arange(ORDERS)).ravel()
        return Saturation([self.losses_of[one] for one in left.tolist()]), numbers

    def _whose(self, setup: ObservingSetup) -> list[int | str]:
        if self.losses_of is not None:
            return list(self.losses_of)
        return [ALL, *setup.observation.antenna_numbers[setup.antennas_in_use].tolist()]

    def _places(self, setup: ObservingSetup) -> IntArray:
        """Return 0 for all antennas, and for each of those in use its place among them, from 1, (n,)."""
        numbers = [int(one) for one in self._whose(setup) if one != ALL]
        known = np.searchsorted(setup.antennas_in_use, antennas_named(setup, numbers, "losses_of")) + 1
        of_antennas = iter(known.tolist())
        return np.array([0 if one == ALL else next(of_antennas) for one in self._whose(setup)], dtype=int)

    def _of_all(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the losses of all antennas and of each beyond that, (1 + Nants in use, `ORDERS`)."""
        losses = np.zeros((len(setup.antennas_in_use) + 1, ORDERS))
        losses[self._places(setup)] = x.reshape(-1, ORDERS)
        return losses

    def _gains(self, block: RowBlock, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the q_k, (Ntimes, `ORDERS`), and the gains of each row's two antennas, (Ntimes, Nbls, 2)."""
        curves = _curves(block.setup, block.channel)[np.searchsorted(block.setup.times, block.times)]
        losses = self._of_all(block.setup, x)
        return curves, 1 - np.einsum("tk,bak->tba", curves, losses[0] + losses[1:][row_antennas(block)])


def _curves(setup: ObservingSetup, channel: int) -> FloatArray:
    """Return the q_k at the times in use, (Ntimes in use, `ORDERS`); found once."""
    key = (Saturation.kind, channel)
    if key not in setup.kept:
        measured = setup.measured_power
        power = usual_powers(setup, channel) if measured is None else measured[channel, setup.times]
        share = power / max(float(np.abs(power).max()), 1e-300)
        functions, root = np.linalg.qr(share[:, np.newaxis] ** np.arange(1, ORDERS + 1))
        # A sign is a matter of the decomposition: each grows with the power.
        setup.kept[key] = np.sqrt(len(power)) * (functions * np.where(np.diag(root) < 0, -1.0, 1.0))
    curves: FloatArray = setup.kept[key]
    return curves
