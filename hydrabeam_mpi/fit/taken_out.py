"""Data without the effects of the instrument: d = C (corrected + E), of which the sky's effects are no part."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import ComplexArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
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


def take_out(context: FitContext, fitted: Fitted) -> tuple[Parts, NDArray[np.bool_]]:
    """Return the parts of a rank's rows, and which of these count, same shape. Serial.

    The model is that of beam and sky, with the functions that effects add to the beam.
    """
    at, data = fitted.estimate, context.test
    rows, added = data.calibrated(at)
    _, taken = data.effects_of(at, [one for one in fitted.values.active if _is_taken_out(one, context.setup)])
    factor, _ = data.effects_of(at, [one for one in fitted.values.active if not one.effect.has_gains])
    model = np.zeros_like(taken)
    for channel in range(len(model)):
        for span, block, _ in data.row_blocks(channel, at, added[channel], rows):
            model[channel, span] = block.vis
    model -= taken
    corrected = rows.data + added - taken
    flipped = context.setup.redundant.flipped[rows.tile.bls]
    taken = factor * (corrected + taken) - corrected
    parts = (np.where(flipped, one.conj(), one) for one in (corrected, model, corrected - model, taken))
    return Parts(*parts), rows.inv_noise_var > 0


def antenna_gains(setup: ObservingSetup, values: Values) -> ComplexArray:
    """Return the gains that the effects stand for, of each channel, time and antenna, (Nfreqs, Ntimes, Nants)."""
    observation = setup.observation
    gains = np.ones((observation.Nfreqs, observation.Ntimes, observation.Nants), dtype=complex)
    for one in values.active:
        for channel in range(len(gains) if one.effect.multiplies else 0):
            gains[channel] *= one.effect.gains(setup, channel, one.x[channel])
    return gains


def _is_taken_out(one: Active, setup: ObservingSetup) -> bool:
    """Whether an effect is neither of the sky nor of the beam that all antennas have."""
    return not (one.effect.of_the_sky or one.effect.changes_sky or is_of_the_beam(setup, one))
