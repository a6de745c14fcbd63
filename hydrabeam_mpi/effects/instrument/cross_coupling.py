"""Cross-coupling: an excess of each baseline that does not change in time."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.per_baseline import PerBaseline


class CrossCoupling(PerBaseline):
    """A complex constant of each baseline and channel, in Jy, whatever its origin.

    What leaks from one receiver into another, the receivers' noise included, correlates at all times alike, while what
    comes from the sky turns at the fringe rate. Fringes of baselines along the meridian hardly turn: there the beam may
    take up some of it.
    """

    kind = "cross_coupling"
    title = "constant cross-coupling"
    is_seen_by_beam = False
    linear = True
    units = ("Jy", "Jy")
    scale = 1.0
    laws: ClassVar = {
        "smooth": "cross-coupling that drifts",
        "sidereal": "cross-coupling that drifts by sidereal time",
        "nightly": "cross-coupling that drifts anew each night",
    }

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several times."""
        if len(setup.times) < 2:
            return "what is constant in time shows only at several times; there is one"
        return None

    def signature(self, block: RowBlock) -> FloatArray:
        """Return ones, (Ntimes, 1)."""
        return np.ones((len(block.times), 1))
