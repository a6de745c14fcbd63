"""Catalogue sources that are wide and not round: elliptical Gaussians on the sky."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.wide_sources import Symmetric
from hydrabeam_mpi.effects.sky.resolved_source import ResolvedSource

NAMES = ("mean squared width (FWHM)", "half of squared width North less East", "covariance of North and East")
TOLD = (("major axis (FWHM)", "arcmin"), ("minor axis (FWHM)", "arcmin"), ("position angle", "deg"))


class ElongatedSource(ResolvedSource):
    """Axes of single sources and where they point to, the same in all channels; fluxes stay as they are.

    Parameters are those of the covariance, in squared widths: m + c towards North, m - c towards East, and s of both.
    The squared axes are m +- r with r = hypot(c, s), and the position angle, North through East, is atan2(s, c) / 2.
    """

    kind = "elongated_source"
    title = "catalogue sources that are elongated"
    unphysical = "a minor axis whose square is below zero"
    n_each = 3

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return mean, difference and covariance of squared widths of every source."""
        own = self.errors(setup, dict.fromkeys(NAMES, 100.0))
        return replace(own, units=("arcmin2",) * len(own))

    def shapes(self, north: FloatArray) -> Sequence[Symmetric]:
        """Return what the covariance changes by with each of them; see `ResolvedSource.shapes`."""
        one, cosine, sine = np.ones(north.shape[1]), north[0] ** 2 - north[1] ** 2, 2 * north[0] * north[1]
        return [(one, 0 * one, one), (cosine, sine, -cosine), (sine, -cosine, -sine)]

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return the sources that may be round, together, as those that are resolved.

        By the data's likelihood of c and s, a Gaussian, beside a prior of as much for all shapes, from a line to a
        circle, which are those with c^2 + s^2 <= m^2: where round is likelier.
        """
        (mean, c, s), (_, of_c, of_s) = (np.moveaxis(one[0].reshape(-1, 3), 1, 0) for one in (x, std))
        told = (of_c > 0) & (of_s > 0)
        of_c, of_s = np.where(told, of_c, 1.0), np.where(told, of_s, 1.0)
        narrower = np.log(np.maximum(mean**2 / (2 * of_c * of_s), 1.0))
        is_round = told & (0.5 * ((c / of_c) ** 2 + (s / of_s) ** 2) < narrower)
        if not is_round.any():
            return []
        resolved = ResolvedSource([self.sources[i] for i in np.flatnonzero(is_round)], self.trials)
        return [(np.repeat(is_round, self.n_each), resolved, mean[is_round])]

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return axes (arcmin) and position angles (deg); their errors take those of the parameters for independent."""
        (mean, c, s), (of_mean, of_c, of_s) = (np.moveaxis(one.reshape(len(one), -1, 3), 2, 0) for one in (x, std))
        r = np.hypot(c, s)
        safe = np.where(r > 0, r, 1.0)
        of_r = np.where(r > 0, np.hypot(c * of_c, s * of_s) / safe, np.hypot(of_c, of_s))
        axes = [np.sqrt(np.maximum(mean + sign * r, 0.0)) for sign in (1, -1)]
        of_square = np.hypot(of_mean, of_r)
        of_axes = [np.divide(of_square, 2 * axis, out=np.sqrt(of_square), where=axis > 0) for axis in axes]
        angle = 0.5 * np.arctan2(s, c) % np.pi
        of_angle = np.minimum(0.5 * np.hypot(s * of_c, c * of_s) / safe**2, np.pi / np.sqrt(12))
        values = np.stack([*axes, np.rad2deg(angle)], axis=-1).reshape(x.shape)
        errors = np.stack([*of_axes, np.rad2deg(of_angle)], axis=-1).reshape(x.shape)
        called = [name.rsplit(": ", 1)[0] for name in self.parameters(setup).names[::3]]
        names = tuple(f"{one}: {name}" for one in called for name, _ in TOLD)
        units = tuple(unit for _ in called for _, unit in TOLD)
        return Told(names, units, values, errors, np.zeros(len(names), dtype=bool))

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse what is narrower than a point in any direction; see `Effect.beyond`."""
        (mean, c, s), errors = (np.moveaxis(one.reshape(len(one), -1, 3), 2, 0) for one in (x, std))
        error = np.sqrt(np.sum(errors**2, axis=0))
        below = sigmas(np.hypot(c, s) - mean, error).max(axis=0)
        return np.repeat(below, 3)

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Make all as wide in the mean and half as much wider along an axis of its own, (n_params,)."""
        mean = strength * self.parameters(setup).scale[::3]
        twice = rng.uniform(0, 2 * np.pi, len(mean))
        return np.stack([mean, 0.5 * mean * np.cos(twice), 0.5 * mean * np.sin(twice)], axis=1).ravel()
