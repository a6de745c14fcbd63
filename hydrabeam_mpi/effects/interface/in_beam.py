"""What of an effect is part of the beam that all antennas have, or a fault of its model."""

from __future__ import annotations

from typing import ClassVar, Self

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.model.bases.base import LinearBasis


class InBeam:
    """An effect's word on the beam: most have no part in it."""

    is_about_the_beam: ClassVar[bool] = False
    """Whether it is a fault of the beam's model itself, so that it may well look like another beam."""
    is_seen_by_beam: bool = True
    """Whether what it adds to the visibilities is in proportion to the beam, or nearly so, as the sky's are."""
    is_sought: ClassVar[bool] = True
    """Whether a loop looks for it, as for what may be wrong; else it is known beforehand."""

    def variances_beforehand(self, setup: ObservingSetup, of_beam: FloatArray) -> FloatArray:
        """Return the prior variances of what is known beforehand, (n_params,).

        ``of_beam`` are those of the beams' coefficients, (Nfreqs, n_modes), for complex ones E|b - m|^2.
        """
        raise NotImplementedError

    def beyond_basis(self, setup: ObservingSetup) -> Self | None:
        """Return the part that no beam in the basis can follow, however free its coefficients are; None without one."""
        return None

    def rest_of_model(self) -> Self | None:
        """Return the part that is in the model beam and in no beam of the basis; None without one."""
        return None

    def beam_functions(self, setup: ObservingSetup) -> LinearBasis | None:
        """Return the functions of the beam, one a parameter, by which the effect makes the beam's basis larger.

        Its parameters are then coefficients of the beam, with which they are written: that of every beam is the basis
        with these functions. None for effects that add none. They are real.
        """
        return None

    def beam_coefficients(self, setup: ObservingSetup, x: FloatArray) -> Array | None:
        """Return what the effect adds to the coefficients of every beam in the job's basis, linear in ``x``.

        That is (..., n_modes) for ``x`` (..., n_params); None for effects that add nothing. What is written of a beam
        has it in it.
        """
        return None
