"""Causes that show in other polarisations than the one that is fitted."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Cause
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup


class CrossPolarised(Cause):
    """A cause that is seen in rows of other polarisations than that from which the beam is inferred."""

    @abstractmethod
    def measured(
        self, setup: ObservingSetup, copols: Mapping[str, ComplexArray], x: FloatArray
    ) -> dict[str, ComplexArray]:
        """Return what is measured of an unpolarised sky in all polarisations, exact, each (Ntimes, Nbls).

        Parameters
        ----------
        setup : ObservingSetup
        copols : mapping of str to ndarray of complex, (Ntimes, Nbls)
            Visibilities without this cause, such as of "ee" and "nn", Jy, in the sense of the observation's antpairs.
        x : ndarray, (n_params,)
            Of one channel; those of several causes of one kind add up.
        """
