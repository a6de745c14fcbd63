"""Control models: a beam that drifts in time. It is never claimed, but effects must explain the data better than it.

All effects are constant, or follow the sky. A beam that changes does neither; sources' fluxes, or more of them, take up
much of it. If its change, linear in time, explains data better than any effect does, then none of these is the cause.
"""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.beam_shapes import MODES, sidelobes, stretches
from hydrabeam_mpi.effects.shared.beam_visibilities import by_real_unknowns
from hydrabeam_mpi.effects.shared.displaced import TILTS, need_real_beam

MOST_MODES = 64
LEAST_TIMES = 4
SHAPE = ("tilt towards East", "tilt towards North", *MODES)
CHANGE = 0.05
FLOOR = 1e-3
"""Least expected change of a mode, relative to that of the largest one."""


class BeamDrift(Effect):
    """Change of the beam's largest modes from the middle to the end of the times, each channel its own."""

    kind = "beam_drift"
    title = "a beam that changes in time"
    linear = True
    is_control_model = True

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse where there are too few times."""
        if setup.observation.Ntimes >= LEAST_TIMES:
            return None
        return f"a change in time needs {LEAST_TIMES} times or more"

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the change of each of the largest modes, expected in proportion to these."""
        amplitudes, modes = _largest(setup)
        scale = np.maximum(amplitudes[modes], FLOOR * amplitudes.max())
        names = [f"change of mode {mode}" for mode in modes.tolist()]
        if setup.basis.is_complex:
            names, scale = [f"{name} {part}" for part in ("real", "imaginary") for name in names], np.tile(scale, 2)
        return Parameters.of(names, "", scale)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the design's columns times the time, from -1 to 1, (Nrows, n)."""
        modes = _largest(block.setup)[1]
        columns = by_real_unknowns(block.design[..., modes])
        values = (columns * _time(block)[:, np.newaxis, np.newaxis]).astype(complex)
        return Columns(values, columns.shape[-1], by_group=True)


class ShapeDrift(BeamDrift):
    """Change of the beam's pointing, widths and sidelobes from the middle to the end of the times.

    A few numbers describe what would take many modes of the basis; each changes independently. A beam of another level
    is no other beam, but the gain that all antennas have in common.
    """

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams, and too few times."""
        return need_real_beam(setup) or super().not_applicable(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the changes: relative ones, and tilts in radians."""
        scale = [*[CHANGE / 5] * len(TILTS.T), *[CHANGE] * len(MODES)]
        return Parameters.of([f"change of {name}" for name in SHAPE], "", np.array(scale), np.arange(len(SHAPE)))

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return how the beam changes with tilts, widths and sidelobes, (8, Nsrc)."""
        tilts = -TILTS.T @ sources.torque
        return np.concatenate([tilts, stretches(sources), sidelobes(sources)])

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return these columns' visibilities times the time, from -1 to 1, (Nrows, n)."""
        values = block.integral(self) * _time(block)[:, np.newaxis, np.newaxis]
        return Columns(values, len(SHAPE), by_group=True)


def _time(block: RowBlock) -> FloatArray:
    """Return the times of a block, from -1 to 1 over all of the observation's."""
    jd = block.setup.observation.times
    return np.asarray(2 * (jd[block.times] - jd.min()) / max(float(np.ptp(jd)), 1e-9) - 1)


def _largest(setup: ObservingSetup) -> tuple[FloatArray, IntArray]:
    """Return how large the model beam's coefficients are over all channels, and which of them are largest."""
    amplitudes = np.sqrt(np.mean(np.square(np.abs(setup.prior_mean)), axis=0))
    return amplitudes, np.sort(np.argsort(-amplitudes, kind="stable")[:MOST_MODES])


def control_models(setup: ObservingSetup) -> list[BeamDrift]:
    """Return the control models that these data can constrain."""
    return [one for one in (BeamDrift(), ShapeDrift()) if one.not_applicable(setup) is None]
