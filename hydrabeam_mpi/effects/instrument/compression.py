"""Compression: V_jk -> g_j g_k V_jk with gains g = 1 - kappa (P(t) - P_0) that fall as the sky gets brighter."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.beam_visibilities import beam_visibilities
from hydrabeam_mpi.effects.shared.in_channels import InChannels
from hydrabeam_mpi.effects.shared.per_antenna import row_antennas
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
from hydrabeam_mpi.model.engines.base import amplitude
from hydrabeam_mpi.model.tabulated import power_of

KJY = 1e3  # Jy in the unit of the parameters


class Compression(InChannels):
    """How much of the gain is lost per kJy that the sky is brighter, of all antennas and of each beyond that.

    A weak cubic term of an amplifier lowers its gain in proportion to the power P that comes in. Of that the receiver's
    own part is constant, and what changes is the sky's: its autocorrelation in the current beam. P_0, at which nothing
    is lost, is the mean of what the model beam sees at the times in use, as calibration sets the gains right on
    average. A gain that grows with the power has kappa < 0.

    Parameters
    ----------
    channels : {"each", "alike"}
        Whether each channel has parameters of its own, or all have the same.
    """

    kind = "compression"
    title = "gains that follow the sky's total power"
    multiplies = True
    has_gains = False
    sees_beam = True

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for equal feeds and several times."""
        if not setup.observation.is_copolar:
            return "the power that compresses is that of equal feeds, such as 'ee'; the model has none"
        if len(setup.times) < 2:
            return "what varies as the sky's power shows only at several times; there is one"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return what all antennas have in common, and what each has beyond that, all of which are elements."""
        numbers = setup.observation.antenna_numbers[setup.antennas_in_use].tolist()
        names = ["compression of all antennas", *(f"antenna {number} compression beyond that" for number in numbers)]
        return Parameters.of(names, "1/kJy", 0.01, np.arange(len(names)))

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the common part that single antennas take back, (n_directions, n_params)."""
        n = len(setup.antennas_in_use)
        return np.append(1.0, -np.ones(n))[np.newaxis] / np.sqrt(n + 1)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return -(P - P_0)/g m for a row's two antennas by themselves and together; ``x`` is (n_params,)."""
        more, gains = _gains(block, x)
        each = -more[:, np.newaxis, np.newaxis] / gains
        values = block.vis[..., np.newaxis] * np.concatenate([each.sum(axis=2, keepdims=True), each], axis=2)
        antennas = row_antennas(block) + 1
        index = np.concatenate([np.zeros_like(antennas[:, :1]), antennas], axis=1)
        return Columns(values, len(x), index)

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return g_j g_k, (Ntimes, Nbls)."""
        return _gains(block, x)[1].prod(axis=2).astype(complex)

    def gains_seen(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the gains of all antennas, one of those that are not in use, (Ntimes, Nants)."""
        gains = np.ones((len(block.times), block.setup.observation.Nants), dtype=complex)
        gains[:, block.setup.antennas_in_use] -= np.outer(_more(block), x[0] + x[1:])
        return gains


def _gains(block: RowBlock, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return P - P_0 in kJy, (Ntimes,), and the gains of each row's two antennas, (Ntimes, Nbls, 2)."""
    more = _more(block)
    return more, 1 - more[:, np.newaxis, np.newaxis] * (x[0] + x[1:])[row_antennas(block)]


def _more(block: RowBlock) -> FloatArray:
    """Return P - P_0 in kJy, (Ntimes,)."""
    power = beam_visibilities(block, np.zeros((1, 3)))[:, 0].real
    return np.asarray((power - usual_powers(block.setup, block.channel).mean()) / KJY)


def usual_powers(setup: ObservingSetup, channel: int) -> FloatArray:
    """Return what the model beam sees of the sky at the times in use, (Ntimes in use,), Jy; found once."""
    key = (Compression.kind, float(channel))
    if key not in setup.kept:
        info = BeamInfo("model", float(setup.observation.freqs[channel]), setup.observation.pols[0])
        beam = CoefficientBeam(setup.basis, setup.prior_mean[channel], info)
        positions, powers = setup.positions(setup.sky, setup.observation), []
        for itime in setup.times.tolist():
            index, za, az = positions.above_horizon(itime)
            powers.append(np.sum(amplitude(setup.sky.flux[channel, index] * power_of(beam, za, az))))
        setup.kept[key] = np.array(powers)
    usual: FloatArray = setup.kept[key]
    return usual
