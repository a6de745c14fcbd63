"""Closure errors: V_ij -> f_ij V_ij with a factor f = exp(a + i phi) of single baselines, constant in time."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.per_antenna import LARGEST_LN, logarithms, lost_signs, phases_without_turns
from hydrabeam_mpi.effects.shared.per_baseline import PerBaseline, sense_of

AT_MOST = 100
"""Baselines that are compared together, at a third of the time that all candidates of a scan take. Where more of them
are at fault something else is."""


class ClosureErrors(PerBaseline):
    """What a correlator does to a baseline beyond what it does to the two antennas, each channel its own.

    Losses of one of its boards, say, or unlike bandpasses of two antennas averaged over a channel. Such factors close
    neither in phase nor in amplitude, by which the data tell them from gains.
    """

    kind = "closure_errors"
    title = "closure errors"
    linear = True
    multiplies = True
    has_gains = False
    parts = ("ln amplitude", "phase")
    units = ("", "rad")
    scale = 0.1

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> ClosureErrors:
        """Return the effect on the first of these baselines; ``hypotheses`` is (Nchosen,)."""
        return super().at(setup, hypotheses[:AT_MOST])

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return what is a gain of an antenna all of whose baselines are meant, (n_directions, n_params)."""
        pairs, every = setup.antenna_index[self._places(setup)], setup.antenna_index.ravel()
        whole = [one for one in np.unique(pairs) if np.sum(pairs == one) == np.sum(every == one)]
        gains, sense = np.zeros((2, len(whole), len(pairs), 2)), sense_of(setup)[self._places(setup)]
        for number, antenna in enumerate(whole):
            first, second = (pairs == antenna).T.astype(float)
            gains[0, number, :, 0], gains[1, number, :, 1] = first + second, sense * (first - second)
        _, sizes, directions = np.linalg.svd(gains.reshape(2 * len(whole), 2 * len(pairs)), full_matrices=False)
        return np.asarray(directions[sizes > 1e-9])

    def signature(self, block: RowBlock) -> ComplexArray:
        """Return the model's visibilities, Jy, (Ntimes, Nbls)."""
        return block.vis

    def begun(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the logarithms of the factors that were found, (..., n_params)."""
        return logarithms(x)

    def needed_at(self, setup: ObservingSetup, x: FloatArray) -> tuple[Effect, IntArray, BoolArray]:
        """Return the effect, and the phases of lost signs."""
        return self, np.arange(x.shape[-1]), lost_signs(x)

    def without_turns(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the parameters with phases from -pi to pi, (..., n_params), where none of them are held by gains."""
        return x if len(self.degenerate_directions(setup)) else phases_without_turns(x)

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return f of every row, (Ntimes, Nbls)."""
        element = self.elements(block)
        ln_amplitude, phase = np.append(x[0::2].clip(-LARGEST_LN, LARGEST_LN), 0.0), np.append(x[1::2], 0.0)
        logarithm = ln_amplitude[element] + 1j * sense_of(block.setup)[block.bls] * phase[element]
        return np.broadcast_to(np.exp(logarithm), block.shape)
