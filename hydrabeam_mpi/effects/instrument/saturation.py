"""Saturation: gains g = 1 - sum_k c_k q_k(P(t)) that fall with powers of the total power P that antennas measure."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.instrument.compression import usual_powers
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.per_antenna import row_antennas

ORDERS = 3
"""Of polynomials in the power: what an amplifier loses near its limit grows faster than in proportion to it."""


class Saturation(Effect):
    """How much of the gain is lost in proportion to three polynomials of the total power.

    Of all antennas, and of each beyond that. The power is the median autocorrelation that the files have, in which
    there is all that comes in: the receivers' own noise, and a galaxy that a catalogue of sources lacks. Without
    autocorrelations it is what the model beam sees of the sky model. The q_k are combinations of P, P^2 and P^3, so
    that nothing is lost where nothing comes in; over the times in use they are orthogonal, with an rms of one.
    """

    kind = "saturation"
    title = "gains that saturate with the total power"
    multiplies = True

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
        numbers = setup.observation.antenna_numbers[setup.antennas_in_use].tolist()
        whose = ["all antennas", *(f"antenna {number} beyond that" for number in numbers)]
        names = [f"{one}, loss of order {order + 1} in the power" for one in whose for order in range(ORDERS)]
        return Parameters.of(names, "", 0.01, np.repeat(np.arange(len(whose)), ORDERS))

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the common part that single antennas take back, of each order, (`ORDERS`, n_params)."""
        n = len(setup.antennas_in_use)
        return np.kron(np.append(1.0, -np.ones(n)), np.eye(ORDERS)) / np.sqrt(n + 1)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return -q_k/g m for a row's two antennas together and by themselves; ``x`` is (n_params,)."""
        curves, gains = _gains(block, x)
        each = -curves[:, np.newaxis, np.newaxis] / gains[..., np.newaxis]
        by_whom = np.concatenate([each.sum(axis=2, keepdims=True), each], axis=2)
        antennas = row_antennas(block) + 1
        whose = np.concatenate([np.zeros_like(antennas[:, :1]), antennas], axis=1)
        index = (ORDERS * whose[..., np.newaxis] + np.arange(ORDERS)).reshape(len(whose), -1)
        values = block.vis[..., np.newaxis] * by_whom.reshape(*by_whom.shape[:2], -1)
        return Columns(values, len(x), index)

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return g_j g_k, (Ntimes, Nbls)."""
        return _gains(block, x)[1].prod(axis=2).astype(complex)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return the gains of all antennas, (Ntimes, Nants); one at times, and of antennas, that are not in use."""
        gains = np.ones((setup.observation.Ntimes, setup.observation.Nants), dtype=complex)
        losses = x.reshape(-1, ORDERS)
        gains[np.ix_(setup.times, setup.antennas_in_use)] -= _curves(setup, channel) @ (losses[0] + losses[1:]).T
        return gains


def _gains(block: RowBlock, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the q_k, (Ntimes, `ORDERS`), and the gains of each row's two antennas, (Ntimes, Nbls, 2)."""
    curves = _curves(block.setup, block.channel)[np.searchsorted(block.setup.times, block.times)]
    losses = x.reshape(-1, ORDERS)
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
