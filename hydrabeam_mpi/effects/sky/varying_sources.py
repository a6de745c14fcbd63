"""Sources that vary: S(t) = sum_k S_k phi_k(t), with the functions of a law in time, at places that stay."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.in_time import EVERY, InTime, Times
from hydrabeam_mpi.effects.shared.nightly_laws import Nightly
from hydrabeam_mpi.effects.shared.point_sources import PointSources
from hydrabeam_mpi.effects.shared.time_laws import LEVEL, Smooth

LIGHT_CURVE = 3
"""Functions that are looked for: level, drift and curvature, of each night where these have their own."""
SHARE = 0.3
"""Of its level, by which a source varies to simulate with: no flux is below zero then."""


class MayVary(PointSources):
    """Sources whose first parameter is a flux, to which what they add is proportional; the others stay as they are."""

    @abstractmethod
    def seen(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return their visibilities had they 1 Jy at the mean frequency, (Ntimes, Ngroups, Nsources)."""

    @abstractmethod
    def refined(self, x: FloatArray, used: IntArray) -> tuple[MayVary, FloatArray, IntArray]:
        """Return the sources in use where they have been found; see `Effect.refined`."""

    def changing(self, law: Smooth) -> VaryingSources:
        """Return the sources with fluxes that vary, at places that stay."""
        return VaryingSources(self, law)

    def known_as(self, names: Sequence[str]) -> dict[str, tuple[int, float]]:
        """Return the parameters also by the names of sources that vary: where nobody knows how, they have their level.

        See `InOtherData.known_as`.
        """
        known = super().known_as(names)
        return known | {f"{name}, {LEVEL}": of for name, of in known.items()}


class VaryingSources(InTime):
    """Sources with a light curve, one place and one spectral index each.

    The level is part of the law, as a source has no flux below zero: what varies at a place without it is no source.
    The parameters of a source are the fluxes S_k, then those that it has if it does not vary.

    Parameters
    ----------
    effect : MayVary
    law : Smooth
    """

    effect: MayVary
    time_law: Smooth
    gets_simpler_when_fitted = True

    def __init__(self, effect: MayVary, law: Smooth) -> None:
        super().__init__(effect, law)

    def unchanging(self, n_params: int) -> tuple[MayVary, IntArray] | None:
        """Return the sources with their level at all times."""
        functions = self.time_law.names()
        if LEVEL not in functions:
            return None
        _, first, is_flux = self._layout(n_params)
        return self.effect, first + np.where(is_flux[first], functions.index(LEVEL), 0)

    def carried_over(self, setup: ObservingSetup) -> Effect | str:  # type: ignore[override]
        """Return the sources; where nobody knows how they vary they have their level, if they had one at all times."""
        here = super().carried_over(setup)
        return self.effect if isinstance(here, str) and not isinstance(self.time_law, Nightly) else here

    def anew(self, setup: ObservingSetup) -> tuple[VaryingSources, dict[str, dict[str, float]]] | None:
        """Return the sources where they are, with fluxes as large as they were; see `InTime.anew`."""
        law, before = self.time_law.anew(setup.jd), self.time_law.names()
        own = self.effect.parameters(setup)
        sizes = {name: {name: 1.0} for name in own.names}
        for name in np.array(own.names)[~own.nonlinear].tolist():
            for function, alike in zip(law[0].names(), law[1], strict=True):
                sizes[f"{name}, {function}"] = {f"{name}, {before[i]}": 1 / len(alike) for i in alike}
        return VaryingSources(self.effect, law[0]), sizes

    def known_as(self, names: Sequence[str]) -> dict[str, tuple[int, float]]:
        """Return the parameters by their names."""
        return {name: (number, 1.0) for number, name in enumerate(names)}

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the fluxes of every source, with each function, its place and its spectral index."""
        own, functions = self.effect.parameters(setup), self.time_law.names()
        of = np.repeat(np.arange(len(own)), np.where(own.nonlinear, 1, len(functions)))
        made = Parameters.of(
            self._named(own.names, len(of)),
            [own.units[i] for i in of],
            own.scale[of],
            own.element[of],
            own.nonlinear[of].tolist(),
            own.trials,
        )
        return replace(made, rare_above=own.rare_above)

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return none, (0, n_params)."""
        return np.zeros((0, len(self.parameters(setup))))

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return fluxes, right ascension, declination and spectral index of every source, (Nfreqs, n_params)."""
        of, first, is_flux = self._layout(x.shape[1])
        own = self.effect.told(setup, x[:, first], std[:, first])
        names, units = self._named(own.names, len(of)), tuple(own.units[i] for i in of)
        values, errors = (np.where(is_flux, here, told[:, of]) for here, told in ((x, own.values), (std, own.std)))
        return Told(names, units, values, errors, own.from_zero[of])

    def refined(self, x: FloatArray, used: IntArray) -> tuple[VaryingSources, FloatArray, IntArray]:
        """Return the sources in use where they have been found; see `Effect.refined`."""
        of, first, is_flux = self._layout(x.shape[1])
        effect, own, left = self.effect.refined(x[:, first], np.unique(of[used]))
        kept = np.flatnonzero(np.isin(of, left))
        values = np.where(is_flux[kept], x[:, kept], own[:, np.searchsorted(left, of[kept])])
        return VaryingSources(effect, self.time_law), values, kept

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the source itself times each function, and its change with place and index; ``x`` is (n_params,)."""
        of, first, is_flux = self._layout(len(x))
        own = self.effect.columns(block, np.where(is_flux, 1.0, x)[first]).values[..., of]
        phi, n = self._functions(block.setup)[block.times], len(self.effect.sources)
        curve = self._fluxes(block.setup, x, block.times)
        times = np.tile(phi, n) if n else np.zeros((len(phi), 0))
        scale = np.empty((len(phi), len(x)))
        scale[:, is_flux] = times
        scale[:, ~is_flux] = np.repeat(curve, np.sum(~is_flux) // max(n, 1), axis=1)
        return Columns(own * scale[:, np.newaxis], len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the sources' visibilities, (Ntimes, Nbls)."""
        seen = self.effect.seen(block, x[self._layout(len(x))[1]])
        return block.spread(np.einsum("tgs,ts->tg", seen, self._fluxes(block.setup, x, block.times)))

    def begun(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the fluxes that were found, (..., n_params)."""
        return x

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse sources with a flux below zero at any time; see `InTime.beyond`."""
        phi, n = self._functions(setup)[setup.times], len(self.effect.sources)
        flux, variance = (
            one.reshape(len(one), n, -1)[..., : phi.shape[1]] @ weights.T
            for one, weights in ((x, phi), (std**2, phi**2))
        )
        below = sigmas(-flux, np.sqrt(variance)).max(axis=(0, 2))
        return np.where(np.any(std > 0, axis=0), np.repeat(below, x.shape[1] // max(n, 1)), 0.0)

    def without(self, gone: BoolArray) -> tuple[VaryingSources, IntArray]:
        """Return the other sources, and the numbers of their parameters, (n_left,); ``gone`` is (n_params,)."""
        of, first, _ = self._layout(len(gone))
        effect, left = self.effect.without(np.bincount(of, gone, len(first)) > 0)
        return VaryingSources(effect, self.time_law), np.flatnonzero(np.isin(of, left))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw sources whose level is ``strength`` Jy, and what varies up to `SHARE` of that, (n_params,)."""
        of, _, is_flux = self._layout(len(self.parameters(setup)))
        x, n = self.effect.draw(setup, rng, strength)[of], len(self.effect.sources)
        share = rng.uniform(-SHARE, SHARE, (n, len(self.time_law.orders)))
        x[is_flux] *= np.where(np.array(self.time_law.orders) == 0, 1.0, share).ravel()
        return x

    def _named(self, own: Sequence[str], n_params: int) -> tuple[str, ...]:
        """Return the names of all parameters, those of fluxes with their functions; ``own`` are those of no law."""
        of, first, is_flux = self._layout(n_params)
        functions = self.time_law.names()
        number = np.arange(n_params) - first[of]
        return tuple(
            f"{own[i]}, {functions[k]}" if flux else own[i] for i, k, flux in zip(of, number, is_flux, strict=True)
        )

    def _layout(self, n_params: int) -> tuple[IntArray, IntArray, BoolArray]:
        """Return which parameter of the source without a law each is one of, the first of each, and which are fluxes.

        They are (n_params,), (n_own,) and (n_params,).
        """
        return _layout(n_params, len(self.effect.sources), len(self.time_law.names()))

    def _fluxes(self, setup: ObservingSetup, x: FloatArray, times: Times = EVERY) -> FloatArray:
        """Return the flux of each source at times of the observation, (Ntimes, Nsources)."""
        is_flux = self._layout(len(x))[2]
        functions = self._functions(setup)[times]
        return functions @ x[is_flux].reshape(len(self.effect.sources), functions.shape[1]).T

    def _at_times(self, setup: ObservingSetup, x: FloatArray, times: Times = EVERY) -> FloatArray:
        """Return the parameters of sources without a law as they are at some times, (Ntimes, n_own)."""
        _, first, is_flux = self._layout(len(x))
        fluxes = self._fluxes(setup, x, times)
        now = np.tile(x[first], (len(fluxes), 1))
        now[:, is_flux[first]] = fluxes
        return now

    def _candidates(self, setup: ObservingSetup) -> Smooth:
        """Return the law with the functions that are looked at."""
        law = self.time_law.over(setup.jd).candidates(setup.fitted_jd, setup.jd)
        return law.with_level().first(LIGHT_CURVE)


@lru_cache
def _layout(n_params: int, n_sources: int, n_functions: int) -> tuple[IntArray, IntArray, BoolArray]:
    """Do as `VaryingSources._layout`."""
    each = n_params // max(n_sources, 1)
    within = np.maximum(np.arange(each) - n_functions + 1, 0)
    of = ((each - n_functions + 1) * np.arange(n_sources)[:, np.newaxis] + within).ravel()
    return of, np.unique(of, return_index=True)[1], np.tile(within == 0, n_sources)
