"""The sky: point sources with their flux densities at the observed frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.random import generator

REFERENCE_FREQ = 100e6
"""Hz, to which fluxes of a mock and cuts refer unless another is asked for."""


@dataclass(frozen=True, eq=False)
class Sky:
    """Unpolarised point sources (or the pixels of a map, each taken as a point).

    Attributes
    ----------
    ra, dec : ndarray, (Nsrc,)
        Radians; ICRS, or of date where the sky is turned by the sidereal time alone.
    flux : ndarray, (Nfreqs, Nsrc)
        Stokes I in Jy at the frequencies of the observation.
    names : tuple of str, optional
        What the catalogue calls the sources.
    reference_flux : ndarray, (Nsrc,), optional
        Jy at the one frequency that brightness cuts refer to, which need not be observed.
    reference_freq : float, optional
        That frequency, Hz.
    """

    ra: FloatArray
    dec: FloatArray
    flux: FloatArray
    names: tuple[str, ...] | None = None
    reference_flux: FloatArray | None = None
    reference_freq: float | None = None

    def __post_init__(self) -> None:
        lengths = {len(self.ra), len(self.dec), self.flux.shape[-1]}
        lengths |= {len(column) for column in (self.names, self.reference_flux) if column is not None}
        if self.flux.ndim != 2 or len(lengths) > 1:
            raise ValueError(f"sky columns of lengths {sorted(lengths)}, flux of shape {self.flux.shape}")

    @property
    def Nsrc(self) -> int:
        """Number of sources."""
        return len(self.ra)

    @property
    def Nfreqs(self) -> int:
        """Number of frequencies."""
        return len(self.flux)

    @property
    def brightness(self) -> FloatArray:
        """What cuts compare, (Nsrc,): the reference flux, or the mean over channels where there is none."""
        return self.flux.mean(axis=0) if self.reference_flux is None else self.reference_flux

    def select(self, sources: IntArray | BoolArray) -> Sky:
        """Keep the sources of an index or mask; ``sources`` is (Nkept,) or (Nsrc,)."""
        index = np.flatnonzero(sources) if sources.dtype == bool else sources
        return Sky(
            ra=self.ra[index],
            dec=self.dec[index],
            flux=np.take(self.flux, index, axis=1),  # C order, which an index would not keep
            names=None if self.names is None else tuple(self.names[i] for i in index),
            reference_flux=None if self.reference_flux is None else self.reference_flux[index],
            reference_freq=self.reference_freq,
        )

    def channels(self, index: IntArray) -> Sky:
        """Keep the frequencies of an index, (Nkept,)."""
        return replace(self, flux=self.flux[index])

    def brighter_than(self, flux_min: float) -> Sky:
        """Keep the sources whose `brightness`, of either sign, is at least ``flux_min`` Jy."""
        return self.select(np.abs(self.brightness) >= flux_min)


def separation(ra1: ArrayLike, dec1: ArrayLike, ra2: ArrayLike, dec2: ArrayLike) -> FloatArray:
    """Return the angle between directions, all in radians and of one shape, (N,); exact at small angles (haversine)."""
    ra1, dec1, ra2, dec2 = (np.asarray(angle, dtype=float) for angle in (ra1, dec1, ra2, dec2))
    squared = np.sin((dec2 - dec1) / 2) ** 2 + np.cos(dec1) * np.cos(dec2) * np.sin((ra2 - ra1) / 2) ** 2
    return 2 * np.arcsin(np.sqrt(np.minimum(squared, 1.0)))


def concatenate(skies: Sequence[Sky]) -> Sky:
    """Join skies at the same frequencies.

    Names are kept if any part has them (the others' sources are called ""), reference fluxes if all parts do.
    """
    names = [sky.names if sky.names is not None else ("",) * sky.Nsrc for sky in skies]
    reference_fluxes = [sky.reference_flux for sky in skies if sky.reference_flux is not None]
    has_reference = len(reference_fluxes) == len(skies)
    return Sky(
        ra=np.concatenate([sky.ra for sky in skies]),
        dec=np.concatenate([sky.dec for sky in skies]),
        flux=np.concatenate([sky.flux for sky in skies], axis=1),
        names=sum(names, ()) if any(sky.names is not None for sky in skies) else None,
        reference_flux=np.concatenate(reference_fluxes) if has_reference else None,
        reference_freq=skies[0].reference_freq if has_reference else None,
    )


def power_law(
    flux: FloatArray,
    reference_freq: FloatArray | float,
    spectral_index: FloatArray | float,
    freqs: FloatArray,
) -> FloatArray:
    """Scale fluxes to other frequencies, S(nu) = S_0 (nu / nu_0)^alpha.

    Parameters
    ----------
    flux : ndarray, (Nsrc,)
        S_0 in Jy.
    reference_freq, spectral_index : ndarray, (Nsrc,), or float
        nu_0 in Hz, and alpha (negative for steep synchrotron sources).
    freqs : ndarray, (Nfreqs,)
        Hz.

    Returns
    -------
    ndarray, (Nfreqs, Nsrc)
    """
    return flux * (freqs[:, np.newaxis] / reference_freq) ** spectral_index


def mock_sky(
    seed: int,
    freqs: FloatArray,
    *,
    n_sources: int = 10_000,
    flux_range: tuple[float, float] = (0.1, 100.0),
    reference_freq: float = REFERENCE_FREQ,
    spectral_index: float = -2.7,
) -> Sky:
    """Draw the mock sky of HDBI II, section 3: uniform on the sphere, log-flat in flux, one spectral index.

    Parameters
    ----------
    seed : int
        The same seed gives the same sky on any rank.
    freqs : ndarray, (Nfreqs,)
        Hz.
    n_sources : int
    flux_range : (float, float)
        Faintest and brightest possible flux in Jy at ``reference_freq``.
    reference_freq : float
        Hz; cuts refer to the fluxes there.
    spectral_index : float

    Returns
    -------
    Sky
        With right ascensions and declinations of date.
    """
    rng = generator(seed, "sky")
    ra = rng.uniform(0.0, 2 * np.pi, n_sources)
    dec = np.arcsin(rng.uniform(-1.0, 1.0, n_sources))
    faintest, brightest = np.log(flux_range)
    flux = np.exp(rng.uniform(faintest, brightest, n_sources))
    at_freqs = power_law(flux, reference_freq, spectral_index, freqs)
    return Sky(ra, dec, at_freqs, reference_flux=flux, reference_freq=reference_freq)
