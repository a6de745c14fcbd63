"""Gains of single antennas in all channels that may follow a law: all alike, a delay, or an echo in the cable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays, delays_of, phases_of
from hydrabeam_mpi.effects.instrument.cable_reflections import CableReflections, echoes_of
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup


@dataclass(frozen=True)
class GainLaw:
    """A law, and where the gains of all antennas come nearest to it.

    Attributes
    ----------
    gains : ndarray, (Nfreqs, Nants, 2)
        ln amplitude and phase.
    n_each : ndarray of int, (Nants,)
        Parameters of each antenna.
    of : callable
        From the positions of antennas in use, (n,), to the effect of these and its parameters, (n_params,).
    """

    gains: FloatArray
    n_each: IntArray
    of: Callable[[IntArray], tuple[Effect, FloatArray]]


def laws_followed(
    setup: ObservingSetup, x: FloatArray, std: FloatArray, alike: Effect
) -> list[tuple[BoolArray, Effect, FloatArray]]:
    """Tell whose gains may be the same in all channels, come from a delay each, or from an echo each.

    By the likelihood of the gains, a Gaussian, along each law, and by what fewer parameters gain by Occam's factor
    with a prior as wide as the gains are large.

    Parameters
    ----------
    setup : ObservingSetup
    x, std : ndarray, (Nfreqs, 2 Nants)
        ln amplitudes and phases of the antennas in use, and their standard deviations; zero for those held at zero.
    alike : Effect
        Gains that all channels have.

    Returns
    -------
    list of (ndarray of bool, (2 Nants,), Effect, ndarray, (n_params,))
        Which are those of the antennas, the effect of the law, and its parameters, where they are about.
    """
    gains, sigma = x.reshape(len(x), -1, 2), std.reshape(len(x), -1, 2)
    used = sigma > 0
    told = np.flatnonzero(used.any(axis=(0, 2)))
    if len(gains) < 2 or not len(told):
        return []
    every = _alike(gains, sigma, alike), _delays(setup, gains), _echoes(setup, gains)
    laws = [law for law in every if law is not None]
    size, known = np.sqrt(np.mean(gains[used] ** 2)), np.where(used, sigma, 1.0)
    narrower = np.where(used, np.log(np.maximum(size / known, 1.0)), 0.0).sum(axis=(0, 2))
    lost = []
    for law in laws:
        away = law.gains - gains
        away[..., 1] = np.angle(np.exp(1j * away[..., 1]))
        # What is held at zero the law must leave there: its error is as large as those of the others at most.
        chi2 = np.sum((away / np.where(used, known, sigma.max())) ** 2, axis=(0, 2))
        spared = 1 - law.n_each / np.maximum(np.count_nonzero(used, axis=(0, 2)), 1)
        lost.append((0.5 * chi2 - spared * narrower)[told])
    best = np.where(np.min(lost, axis=0) < 0, np.argmin(lost, axis=0), len(laws))
    found = []
    for number, law in enumerate(laws):
        antennas = told[best == number]
        if len(antennas):
            found.append((np.repeat(np.isin(np.arange(gains.shape[1]), antennas), 2), *law.of(antennas)))
    return found


def _alike(gains: FloatArray, sigma: FloatArray, effect: Effect) -> GainLaw:
    weights = np.where(sigma > 0, np.where(sigma > 0, sigma, 1.0) ** -2.0, 1.0)
    turned = gains.copy()
    turned[..., 1] = gains[:1, :, 1] + np.angle(np.exp(1j * (gains[..., 1] - gains[:1, :, 1])))
    mean = np.sum(weights * turned, axis=0) / np.sum(weights, axis=0)

    def of(antennas: IntArray) -> tuple[Effect, FloatArray]:
        return effect, np.where(np.isin(np.arange(len(mean)), antennas)[:, np.newaxis], mean, 0.0).ravel()

    return GainLaw(np.broadcast_to(mean, gains.shape), np.count_nonzero((sigma > 0).any(axis=0), axis=1), of)


def _delays(setup: ObservingSetup, gains: FloatArray) -> GainLaw | None:
    effect = AntennaDelays()
    if effect.not_applicable(setup) is not None:
        return None
    x = delays_of(setup, gains[..., 1])
    phases = np.array([phases_of(setup, channel, x) for channel in range(len(gains))])

    def of(antennas: IntArray) -> tuple[Effect, FloatArray]:
        return effect, np.where(np.isin(np.arange(len(x)) // 2, antennas), x, 0.0)

    return GainLaw(np.stack([np.zeros_like(phases), phases], axis=-1), np.full(phases.shape[1], 2), of)


def _echoes(setup: ObservingSetup, gains: FloatArray) -> GainLaw | None:
    if CableReflections().not_applicable(setup) is not None:
        return None
    delays, amplitudes, made = echoes_of(setup, np.exp(gains[..., 0] + 1j * gains[..., 1]))
    numbers = setup.observation.antenna_numbers[setup.antennas_in_use]

    def of(antennas: IntArray) -> tuple[Effect, FloatArray]:
        z = amplitudes[antennas]
        x = np.stack([z.real, z.imag, np.zeros(len(z))], axis=-1)
        return CableReflections(
            list(zip(numbers[antennas].tolist(), delays[antennas].tolist(), strict=True))
        ), x.ravel()

    return GainLaw(np.stack([np.log(np.abs(made)), np.angle(made)], axis=-1), np.full(made.shape[1], 3), of)
