"""From ``[prior.frequency]`` of a job to the modes along frequency that its beams are solved for in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.config.frequency import OverFrequency
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.over_frequency import KERNELS, legendre, modes_of, within_delay
from hydrabeam_mpi.inference.prior import DiagonalPrior, Prior

N_LENGTHS = 8
"""Lengths that are tried at first where a job gives none: each is two to three times the one before over most bands."""


@dataclass(frozen=True)
class Coupling:
    """How the beams of all channels hang together.

    Attributes
    ----------
    settings : OverFrequency
    candidates : tuple of ndarray, (Nchan, M)
        Modes along frequency, U; several where the evidence decides among lengths.
    lengths : tuple of float
        Of each of these, Hz; none of modes.
    freqs : ndarray, (Nchan,)
        Hz.
    """

    settings: OverFrequency
    candidates: tuple[FloatArray, ...]
    lengths: tuple[float, ...]
    freqs: FloatArray

    @property
    def may_refine(self) -> bool:
        """Whether the length is one that the evidence is to find, and not one of those that the job gives."""
        return not self.settings.length and len(self.lengths) > 1 and self.settings.evidence == "maximise"

    def with_length(self, length: float) -> tuple[Coupling, int]:
        """Return the same with one length more, and its place among the lengths, which are in ascending order."""
        place = int(np.searchsorted(self.lengths, length))
        modes = _modes_within(self.settings, self.freqs, length)
        candidates = (*self.candidates[:place], modes, *self.candidates[place:])
        return replace(
            self, candidates=candidates, lengths=(*self.lengths[:place], length, *self.lengths[place:])
        ), place


def couple(settings: OverFrequency, freqs: FloatArray, priors: Sequence[Prior] = ()) -> Coupling | None:
    """Return how the beams of channels at ``freqs``, Hz, (Nchan,), hang together; None where they do not.

    Raises
    ------
    InputError
        If the channels do not allow what is asked for, or their ``priors`` are not of independent coefficients.
    """
    if not settings.couples:
        return None
    if any(not isinstance(prior, DiagonalPrior) for prior in priors):
        raise InputError(
            "beams that hang together over frequency need a prior of independent coefficients in each channel",
            field="[prior.frequency] kind",
            remedy="give [prior] kind = 'fraction', or priors of that kind, or set kind = 'independent'",
        )
    if settings.kind == "modes":
        return Coupling(settings, (_modes(settings, freqs),), (), freqs)
    lengths = settings.length or _lengths(freqs)
    return Coupling(settings, tuple(_modes_within(settings, freqs, length) for length in lengths), lengths, freqs)


def _modes_within(settings: OverFrequency, freqs: FloatArray, length: float) -> FloatArray:
    """Return the modes of a process of that length, Hz."""
    return modes_of(KERNELS[settings.kernel](freqs, length))


def _modes(settings: OverFrequency, freqs: FloatArray) -> FloatArray:
    if settings.n_modes is not None and settings.n_modes > len(freqs):
        raise InputError(
            f"is {settings.n_modes}, and there are {len(freqs)} channels",
            field="[prior.frequency] n_modes",
            remedy="ask for no more modes than channels",
        )
    if settings.modes == "legendre":
        assert settings.n_modes is not None
        return legendre(freqs, settings.n_modes)
    assert settings.delay is not None
    return modes_of(within_delay(freqs, settings.delay), settings.n_modes)


def _lengths(freqs: FloatArray) -> tuple[float, ...]:
    """Return lengths from half of the usual spacing, where channels are nearly independent, to four times the band.

    Raises
    ------
    InputError
        If there is one channel alone.
    """
    if len(freqs) < 2:
        raise InputError(
            "one channel does not tell how smooth a beam is over frequency",
            field="[prior.frequency] length",
            remedy="give a length, or more channels",
        )
    spacing, band = float(np.median(np.diff(np.sort(freqs)))), float(np.ptp(freqs))
    return tuple(np.geomspace(0.5 * spacing, 4 * band, N_LENGTHS).tolist())
