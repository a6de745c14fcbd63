"""Data without the effects of the instrument: d = C (corrected + E), of which the sky's effects are no part."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import ComplexArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.carried_over import untold
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.grown import is_of_the_beam
from hydrabeam_mpi.fit.state import Active, Fitted, Values


class Parts(NamedTuple):
    """What data consist of, each (Nlocal, Ntimes, Nbls), Jy, baselines as they are stored.

    ``corrected`` is ``model`` plus ``residual``, and g_j g_k* (``corrected`` + ``added``) the data. Factors
    for which no gains of antennas stand are part of what is added.
    """

    corrected: ComplexArray
    model: ComplexArray
    residual: ComplexArray
    added: ComplexArray


class TakenOut(NamedTuple):
    """The parts of a rank's rows, and the gains that effects stand for.

    Attributes
    ----------
    parts : Parts
    usable : ndarray of bool, (Nlocal, Ntimes, Nbls)
        Which rows count.
    gains : ndarray of complex, (Nlocal, Ntimes, Nants)
    unknown : ndarray of bool, (Nlocal, Ntimes, Nants)
        Which of the gains that single times have of their own the result does not tell.
    """

    parts: Parts
    usable: NDArray[np.bool_]
    gains: ComplexArray
    unknown: NDArray[np.bool_]


def take_out(context: FitContext, fitted: Fitted) -> TakenOut:
    """Take a rank's rows apart. Serial.

    The model is that of beam and sky, with the functions that effects add to the beam.
    """
    at, data = fitted.estimate, context.test
    rows, added = data.calibrated(at)
    gains, factor, taken = _of_instrument(context, fitted)
    model = np.zeros_like(taken)
    for channel in range(len(model)):
        for span, block, _ in data.row_blocks(channel, at, added[channel], rows):
            model[channel, span] = block.vis
    model -= taken
    one, two = context.setup.antenna_index[rows.tile.bls].T
    # By the very gains that are written: those of a fit may be worked out anew with other rounding.
    whole = gains[..., one] * gains[..., two].conj() * factor
    usable = rows.inv_noise_var > 0
    corrected = np.where(usable, data.rows.data / np.where(usable, whole, 1.0), 0.0) - taken
    flipped = context.setup.redundant.flipped[rows.tile.bls]
    taken = factor * (corrected + taken) - corrected
    parts = (np.where(flipped, one.conj(), one) for one in (corrected, model, corrected - model, taken))
    return TakenOut(Parts(*parts), usable, gains, _unknown(context, fitted))


def _of_instrument(context: FitContext, fitted: Fitted) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return what the instrument does to a rank's rows, baselines in the sense of their groups.

    Returns
    -------
    gains : ndarray of complex, (Nlocal, Ntimes, Nants)
    factor, added : ndarray of complex, (Nlocal, Ntimes, Nbls)
        What multiplies besides, and what is added (Jy) before.
    """
    at, data, setup = fitted.estimate, context.test, context.setup
    factor = np.ones(data.rows.data.shape, dtype=complex)
    added, nothing = np.zeros_like(factor), np.zeros(factor.shape[1:], dtype=complex)
    gains = np.ones((*factor.shape[:2], setup.observation.Nants), dtype=complex)
    here = of_instrument(setup, fitted.values)
    for channel, number in enumerate(context.channels if here else ()):
        for span, block, _ in data.row_blocks(channel, at, nothing, data.rows):
            for one in here:
                if not one.effect.multiplies:
                    added[channel, span] += block.added_by(one.effect, one.x[number])
                elif (of_antennas := one.effect.gains_seen(block, one.x[number])) is not None:
                    gains[channel, span] *= of_antennas
                else:
                    factor[channel, span] *= one.effect.factor(block, one.x[number])
    return gains, factor, added


def _unknown(context: FitContext, fitted: Fitted) -> NDArray[np.bool_]:
    """Return which gains differ from time to time and are not told at a time, (Nlocal, Ntimes, Nants)."""
    setup, times, values = context.setup, context.test.rows.tile.times, fitted.values
    unknown = np.zeros((len(context.channels), len(times), setup.observation.Nants), dtype=bool)
    for channel, (number, covariance) in enumerate(zip(context.channels, fitted.fit.covariances, strict=False)):
        of_all = untold(covariance, values.prior_std(number))
        for one, span in zip(values.active, values.spans, strict=True):
            if not (one.effect.multiplies and one.effect.local == "times"):
                continue
            parameters, told = one.effect.parameters(setup), np.zeros(one.x.shape[1], dtype=bool)
            told[one.used[~of_all[span]]] = True
            # What of an antenna is not in use, as times that the result's data lack, is not told either.
            lost = np.isin(parameters.element, parameters.element[one.used]) & ~told
            moved = one.x[number] + np.where(lost, parameters.scale, 0.0)
            gains, others = (one.effect.gains(setup, number, x) for x in (one.x[number], moved))
            unknown[channel] |= (gains != others)[times]
    return unknown


def antenna_gains(setup: ObservingSetup, values: Values) -> ComplexArray:
    """Return the gains that effects stand for whatever the beam is, (Nfreqs, Ntimes, Nants)."""
    observation = setup.observation
    gains = np.ones((observation.Nfreqs, observation.Ntimes, observation.Nants), dtype=complex)
    for one in values.active:
        for channel in range(len(gains) if one.effect.multiplies else 0):
            gains[channel] *= one.effect.gains(setup, channel, one.x[channel])
    return gains


def of_instrument(setup: ObservingSetup, values: Values) -> list[Active]:
    """Return the effects that are neither of the sky nor of the beam that all antennas have."""
    return [one for one in values.active if one.effect.multiplies or not _is_of_sky_or_beam(one, setup)]


def _is_of_sky_or_beam(one: Active, setup: ObservingSetup) -> bool:
    return one.effect.of_the_sky or one.effect.changes_sky or is_of_the_beam(setup, one)
