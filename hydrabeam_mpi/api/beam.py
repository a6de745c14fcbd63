"""The posterior of the beam, just computed or read from a result folder."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.io.posterior_file import PosteriorFile, read_covariance, read_matrix
from hydrabeam_mpi.model.bases import basis_from_description
from hydrabeam_mpi.random import complex_normal, generator

if TYPE_CHECKING:
    from pyuvdata import UVBeam


class InferredBeam:
    """The posterior of the beam's coefficients, a Gaussian in each channel.

    Beams are power relative to the peak of the model beam as it was given, and coefficients likewise.

    Parameters
    ----------
    content : PosteriorFile
    path : Path, optional
        The file from which covariances are read when they are asked for, where the channels have none.

    Attributes
    ----------
    basis : LinearBasis
    freqs : ndarray, (Nfreqs,)
        Hz.
    polarization : str
        The two feeds: "ee", "nn", "en", "ne", or with x and y where their directions are not known.
    """

    def __init__(self, content: PosteriorFile, path: Path | None = None) -> None:
        self._content, self._path = content, path
        self.basis = basis_from_description(content.basis)
        self.freqs = np.array([record.freq for record in content.channels])
        self.polarization = content.polarization

    def _stacked(self, name: str) -> Array:
        return np.array([record.arrays[name] for record in self._content.channels])

    @cached_property
    def mean(self) -> Array:
        """Posterior mean of the coefficients, (Nfreqs, n_modes)."""
        return self._stacked("mean")

    @cached_property
    def std(self) -> FloatArray:
        """Posterior standard deviation of the coefficients, sqrt(E|b - mean|^2), (Nfreqs, n_modes).

        Of complex ones that is of real and imaginary part together, each of which has 1/sqrt(2) of it.
        """
        return self._stacked("std")

    @cached_property
    def covariance(self) -> Array:
        """E[(b - mean)(b - mean)^H], (Nfreqs, n_modes, n_modes); read from the file when first asked for."""
        return np.array([self.covariance_of(channel) for channel in range(len(self.freqs))])

    def covariance_of(self, channel: int) -> Array:
        """Return that of one channel, (n_modes, n_modes)."""
        if self._path is None:
            return self._content.channels[channel].arrays["covariance"]
        return read_covariance(self._path, channel)

    def matrix(self, channel: int, name: str) -> Array:
        """Return a matrix of one channel by its name in ``posterior.h5``, (n_modes, n_modes)."""
        if name == "covariance":
            return self.covariance_of(channel)
        return (
            self._content.channels[channel].arrays[name]
            if self._path is None
            else read_matrix(self._path, channel, name)
        )

    @property
    def maps(self) -> dict[str, Array]:
        """Beams on the one-degree grid, (Nfreqs, 91, 360), zenith angle first: mean, std, model and any truth.

        The mean is that which the beam itself returns when it is called, the standard deviation sqrt(E|B - mean|^2),
        of the complex form of real and imaginary part together.
        """
        names = ("mean", "std", "model", "truth")
        held = self._content.channels[0].arrays
        return {name: self._as_power(self._stacked(f"map_{name}")) for name in names if f"map_{name}" in held}

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Return the mean beam in some directions.

        Parameters
        ----------
        za, az : ndarray, (Npoints,)
            Zenith angle, and azimuth from East through North, in radians.

        Returns
        -------
        ndarray, (Nfreqs, Npoints)
            Real where both feeds are the same, also of complex coefficients: a power beam is.
        """
        beams = [self.basis.synthesize(mean, np.asarray(za), np.asarray(az)) for mean in self.mean]
        return self._as_power(np.array(beams))

    def _as_power(self, values: Array) -> Array:
        """Return the real part where both feeds are the same; of the complex form the imaginary one is an error."""
        return values.real if self.polarization[0] == self.polarization[1] else values

    def draw(self, n: int, seed: int = 0) -> Array:
        """Draw coefficients from the posterior: those of ``posterior.h5`` where the seed is the job's.

        Where beams hang together over frequency, a draw is one of all channels together.

        Parameters
        ----------
        n : int
        seed : int

        Returns
        -------
        ndarray, (n, Nfreqs, n_modes)
        """
        if self._content.over_frequency:
            return self._draw_together(n, seed)
        draws = np.empty((n, *self.mean.shape), self.mean.dtype)
        for channel, (mean, covariance) in enumerate(zip(self.mean, self.covariance, strict=True)):
            # The upper root C = M M^H, which is the inverse of the factor L^H of the precision, as draws are written.
            root = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]
            for number in range(n):
                rng = generator(seed, "posterior draw", channel, number)
                white = complex_normal(rng, mean.shape) if np.iscomplexobj(mean) else rng.standard_normal(len(mean))
                draws[number, channel] = mean + root @ white
        return draws

    def _draw_together(self, n: int, seed: int) -> Array:
        from hydrabeam_mpi.fit.coupled_draws import check_drawn_again, draw_again

        told = self._content.over_frequency
        assert told is not None
        check_drawn_again(told)
        parts = ((self.matrix(channel, "information"), score) for channel, score in enumerate(self._stacked("score")))
        away = draw_again(told, self.freqs, parts, self._stacked("prior_std"), seed, n)
        return np.asarray(self._stacked("prior_mean") + self._stacked("prior_std") * away)

    def to_uvbeam(self) -> UVBeam:
        """Return the maximum a posteriori power beam on the one-degree grid, all channels in one UVBeam.

        Its real part, as of a power beam; the largest imaginary part is its keyword IMAGMAX.
        """
        from hydrabeam_mpi.io.beamfits import power_uvbeam
        from hydrabeam_mpi.result.output import map_beams

        return power_uvbeam(**map_beams(self._content))
