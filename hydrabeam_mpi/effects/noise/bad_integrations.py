"""A few integrations with something else on all baselines, such as interference: each has a noise scale of its own."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.noise.standing_out import StandingOut


class BadIntegrations(StandingOut):
    """Integrations to leave out, as they stand out from all others of the data.

    The parameters of a channel are the noise scales of all integrations: one for those that are as they should be.
    """

    kind = "bad_integrations"
    title = "bad integrations"
    parts = "integrations"

    def neutral(self, setup: ObservingSetup) -> dict[str, float]:
        """Return ones."""
        return dict.fromkeys((f"JD {jd:.6f} noise scale" for jd in setup.observation.times[setup.times]), 1.0)

    def looked_at(self, setup: ObservingSetup) -> IntArray:
        """Return the times that are looked at."""
        return setup.times

    def by_part(self, setup: ObservingSetup, times: IntArray, bls: IntArray, rows: FloatArray) -> FloatArray:
        """Add up something of rows by time."""
        found = np.zeros(setup.observation.Ntimes)
        found[times] = rows.sum(axis=1)
        return found

    def scales(self, setup: ObservingSetup, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return the noise scales of times, (Ntimes, 1)."""
        return x[np.searchsorted(setup.times, times)][:, np.newaxis]
