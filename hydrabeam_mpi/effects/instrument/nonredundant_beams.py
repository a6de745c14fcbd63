"""Antennas whose beams differ in shape."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.antenna_beams import added_by_beams
from hydrabeam_mpi.effects.shared.beam_shapes import MODES, reshaped, sidelobes, stretches
from hydrabeam_mpi.effects.shared.displaced import need_real_beam
from hydrabeam_mpi.effects.shared.in_channels import InChannels
from hydrabeam_mpi.effects.shared.per_antenna import antenna_parameters, common_values, row_parameters


class NonredundantBeams(InChannels):
    """Each antenna's power beam differs from the common one in a few low modes.

    The power beam of a baseline is the product of its antennas' voltage beams, the positive roots of their power beams
    (`antenna_beams`): for small differences

        E_ij = 1/2 sum_n (c_i + c_j)_n D_n

    with D_n the visibilities of mode n, as which it is linearised. The modes come from the current beam itself,
    whatever its basis:

    - three widths: fractional stretches of the disc of direction cosines (nearly), along East-West, along North-South,
      and along one diagonal at the expense of the other. They do what a reflector's size, its astigmatism and
      a turned feed do;
    - three sidelobe levels: B (1 - B)^8 times 1, e and n (the direction cosines). They leave the main lobe as it is, so
      that they are no gain, no pointing and no width. They do what illumination, blockage and a feed off its axis
      (coma) do.

    A change by a constant is a gain, and a gradient of the beam is a pointing error: those are other effects. What all
    antennas have in common is a beam of another shape, which the beam's own freedom takes up.

    Parameters
    ----------
    channels : {"each", "alike"}
        Whether each channel has parameters of its own, or all have the same.
    """

    kind = "nonredundant_beams"
    title = "beams that differ between antennas"

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams."""
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the modes' amplitudes for every antenna: relative changes of width and of sidelobe level."""
        return antenna_parameters(setup, MODES, "", 0.05)

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the modes, (6, Nsrc)."""
        return np.concatenate([stretches(sources), sidelobes(sources)])

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the shape that all antennas have in common, (n_directions, n_params)."""
        return common_values(len(setup.antennas_in_use), len(MODES))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return half the modes' visibilities, for a row's first and second antenna; ``x`` is (n_params,)."""
        values = block.spread(0.5 * np.tile(block.integral(self), 2))
        n_params = len(MODES) * len(block.setup.antennas_in_use)
        return Columns(values, n_params, row_parameters(block, len(MODES)))

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the antennas' shapes change, (Ntimes, Nbls)."""
        shapes = x.reshape(-1, len(MODES))
        shaped = np.flatnonzero(shapes.any(axis=1))

        def beams(sources: Sources) -> FloatArray:
            return np.array([reshaped(sources, shape) for shape in shapes[shaped]])

        return added_by_beams(block, shaped, beams)
