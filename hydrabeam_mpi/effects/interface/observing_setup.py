"""What is known before any visibility is read."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.redundancy import RedundantGroups
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.rest import Rest
from hydrabeam_mpi.model.bases.with_rest import WithRest
from hydrabeam_mpi.model.fit import Evaluable, rest_of
from hydrabeam_mpi.model.positions import ApparentPositions, SourcePositions
from hydrabeam_mpi.model.sky import Sky

FEEDS = (("e", "n"), ("x", "y"), ("r", "l"))
"""The two feeds of an element, by the names that polarisations have."""


@dataclass(frozen=True)
class ObservingSetup:
    """What is known before any visibility is read, the same on every rank.

    Attributes
    ----------
    observation : Observation
        Of all channels.
    redundant : RedundantGroups
        Of the observation's baselines.
    sky : Sky
        The sky model at the observation's channels.
    basis : LinearBasis
        Of the beam.
    prior_mean : tuple of ndarray, (n_modes,)
        Fitted coefficients of each channel's model beam.
    file_pols : tuple of str
        All polarisations that the data files have.
    times : ndarray of int
        Indices of the times in use, for fitting or held out.
    fitted : ndarray of int, optional
        Those of them that are fitted; all by default.
    positions : callable
        From a sky and the observation to the `SourcePositions` by the job's rule.
    measured_power : ndarray, (Nfreqs, Ntimes), optional
        Median autocorrelation at all times, in the data's units, where files have such.
    model_beam : callable, optional
        That of the middle channel, for what its fit leaves of it; see `rest_of_model`.
    """

    observation: Observation
    redundant: RedundantGroups
    sky: Sky
    basis: LinearBasis
    prior_mean: tuple[Array, ...]
    file_pols: tuple[str, ...]
    times: IntArray
    positions: Callable[[Sky, Observation], SourcePositions] = ApparentPositions
    fitted: IntArray | None = None
    measured_power: FloatArray | None = None
    model_beam: Evaluable | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is kept, which other ranks make anew."""
        return {name: value for name, value in self.__dict__.items() if name != "kept"}

    @cached_property
    def kept(self) -> dict[tuple[Hashable, ...], Any]:
        """What effects make of it alone and need again, by a name and what else tells it."""
        return {}

    @property
    def model_amplitudes(self) -> FloatArray:
        """How large the model beam's coefficients are over all channels, root mean square, (n_modes,)."""
        amplitudes = [self.basis.amplitudes(coeffs) for coeffs in self.prior_mean]
        return np.asarray(np.sqrt(np.mean(np.square(amplitudes), axis=0)))

    @property
    def rest_of_model(self) -> Rest | None:
        """What the basis leaves of the model beam; None where that is nothing, not known, or a function of the basis.

        It is that of the middle channel: beams of one band are left over alike.
        """
        if self.model_beam is None or isinstance(self.basis, WithRest):
            return None
        if ("rest",) not in self.kept:
            self.kept["rest",] = rest_of(self.model_beam, self.basis, self.prior_mean[len(self.prior_mean) // 2])
        rest: Rest | None = self.kept["rest",]
        return rest

    @property
    def reference_freq(self) -> float:
        """Hz: the mean of all channels, to which laws in frequency refer."""
        return float(self.observation.freqs.mean())

    @property
    def jd(self) -> FloatArray:
        """The times in use, JD ascending, (Ntimes in use,)."""
        return np.sort(self.observation.times[self.times])

    @property
    def fitted_jd(self) -> FloatArray:
        """Those of them that are fitted, JD ascending."""
        return self.jd if self.fitted is None else np.sort(self.observation.times[self.fitted])

    @cached_property
    def antenna_index(self) -> IntArray:
        """Indices into ``observation.antenna_numbers`` of the baselines' antennas, (Nbls, 2), in the groups' sense."""
        index = self.observation.antenna_index
        return np.where(self.redundant.flipped[:, np.newaxis], index[:, ::-1], index)

    @cached_property
    def antennas_in_use(self) -> IntArray:
        """Indices of the antennas that have a baseline, ascending; per-antenna effects have elements for these.

        The result is (Nused,).
        """
        return np.unique(self.antenna_index)
