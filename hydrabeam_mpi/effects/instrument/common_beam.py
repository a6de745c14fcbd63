"""What the beams of all channels have in common: they are made by the same antennas, and off alike."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.beam_visibilities import by_real_unknowns


class CommonBeam(Effect):
    """Coefficients c of the beam that are the same in all channels, beside those that each channel has of its own.

    The beam of channel f is b_f = m_f + c + d_f, with m_f its model. A tilt of the beam, or a beam that is wider than
    its model, is in c. With d_f alone it would be as many coincidences as there are channels, which an error of the sky
    or of the pointing, the same in all channels, would explain at once.

    It is no fault that one looks for, but what is known of beams: a loop over several channels begins with it.
    """

    kind = "common_beam"
    title = "what the beams of all channels have in common"
    is_seen_by_beam = False
    of_both_feeds = True
    linear = True
    shared = True
    is_about_the_beam = True
    is_sought = False

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse a single channel."""
        return "it takes several channels to have something in common" if setup.observation.Nfreqs == 1 else None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the coefficients, real parts first, in units of how large the model's are over all channels."""
        scale = setup.basis.expected(setup.model_amplitudes)
        names = [f"coefficient {mode} in all channels" for mode in range(len(scale))]
        if setup.basis.is_complex:
            names = [f"{name}, {part} part" for part in ("real", "imaginary") for name in names]
            scale = np.tile(scale, 2)
        return Parameters.of(names, "", scale)

    def variances_beforehand(self, setup: ObservingSetup, of_beam: FloatArray) -> FloatArray:
        """Return those of a channel's own coefficients, their mean over channels: c is as free as each d_f."""
        of_all = of_beam.mean(axis=0)
        return np.tile(of_all / 2, 2) if setup.basis.is_complex else of_all

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the design as it follows real numbers; ``x`` is (n_params,)."""
        columns = by_real_unknowns(block.design if block.design.shape[-1] else _design(block))
        return Columns(columns, columns.shape[-1], by_group=True)

    def carried_over(self, setup: ObservingSetup) -> str:
        """Refuse: the beams that are carried over have it in them."""
        return "is in the beams already"

    def beam_coefficients(self, setup: ObservingSetup, x: FloatArray) -> Array:
        """Return c, (..., n_modes)."""
        if not setup.basis.is_complex:
            return x
        real, imaginary = np.split(x, 2, axis=-1)
        return np.asarray(real + 1j * imaginary)


def _design(block: RowBlock) -> Array:
    """Return the design where there is none yet, as where data are made."""
    basis = block.setup.basis
    seen = block.integrate(lambda sources: basis.columns(sources.za, sources.az))
    seen = basis.mix(seen.reshape(len(block.times), len(block.groups), basis.n_columns))
    seen = seen + block.diffuse_integral("basis", basis)
    return seen if basis.is_complex else np.stack([seen.real, seen.imag], axis=1)
