"""A sky as an object of pyradiosky, which writes it as skyh5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from astropy import units
from astropy.coordinates import ICRS, TETE, SkyCoord
from astropy.time import Time

from hydrabeam_mpi.data.observation import FloatArray, Observation
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.model.sky import Sky

if TYPE_CHECKING:
    from pyradiosky import SkyModel


@dataclass(frozen=True)
class Spectrum:
    """At which frequencies the fluxes of a sky are known.

    Attributes
    ----------
    freqs : ndarray, (Nfreqs,)
        Hz, of ``Sky.flux``.
    reference_freq : float, optional
        Hz, of ``Sky.reference_flux``.
    index : float, optional
        Of the power law about the reference flux that all sources follow, if they do.
    """

    freqs: FloatArray
    reference_freq: float | None = None
    index: float | None = None


def sky_model(sky: Sky, spectrum: Spectrum, of_date: Observation | None = None) -> SkyModel:
    """Return a sky as point sources.

    Parameters
    ----------
    sky : Sky
    spectrum : Spectrum
    of_date : Observation, optional
        Where it is given, the places of the sky are those of the date of its middle (true equator and equinox, TETE),
        and otherwise ICRS.
    """
    from pyradiosky import SkyModel  # takes long to import, which only what writes a sky needs

    frame = ICRS()
    if of_date is not None:
        # As text: pyradiosky cannot read a date in any other form again.
        frame = TETE(obstime=Time(Time(of_date.times.mean(), format="jd").isot), location=of_date.location)
    spectral, stokes_i = _fluxes(sky, spectrum)
    stokes = np.zeros((4, *stokes_i.shape))
    stokes[0] = stokes_i
    with quiet():
        return SkyModel(
            name=list(sky.names or (f"source {k}" for k in range(sky.Nsrc))),
            skycoord=SkyCoord(sky.ra * units.rad, sky.dec * units.rad, frame=frame),
            stokes=stokes * units.Jy,
            **spectral,
        )


def _fluxes(sky: Sky, spectrum: Spectrum) -> tuple[dict[str, object], FloatArray]:
    """Return how pyradiosky calls a spectrum, and its fluxes (Nfreqs or 1, Nsrc)."""
    if spectrum.index is not None and sky.reference_flux is not None:
        law = {
            "spectral_type": "spectral_index",
            "reference_frequency": np.full(sky.Nsrc, spectrum.reference_freq) * units.Hz,
            "spectral_index": np.full(sky.Nsrc, spectrum.index),
        }
        return law, sky.reference_flux[np.newaxis]
    freqs, flux = spectrum.freqs, sky.flux
    if sky.reference_flux is not None and spectrum.reference_freq is not None:
        freqs, flux = np.append(freqs, spectrum.reference_freq), np.vstack([flux, sky.reference_flux])
    freqs, first = np.unique(freqs, return_index=True)
    return {"spectral_type": "full", "freq_array": freqs * units.Hz}, flux[first]
