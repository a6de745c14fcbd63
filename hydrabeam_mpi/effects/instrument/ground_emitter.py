"""Emitters on the ground: E_ij = S exp(2 pi i nu b.s/c) with s on the horizon, constant in time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.grating_lobes import grating_lobes
from hydrabeam_mpi.effects.shared.point_sources import resolution
from hydrabeam_mpi.effects.shared.settings import Azimuth

SPACING = 0.2  # of candidates, in resolutions: fine, as a scan along one line costs little
AT_MOST = 10
"""Emitters that are weighed together; where there are more, the next come a round later."""
AT_ONCE = 256
"""Candidates that are looked at together: of all of HERA's baselines 33 MB."""
DEGREE = np.pi / 180


class GroundEmitter(ScannedEffect):
    """Transmitters, or what sparks, far away in fixed directions, with a power and an azimuth in each channel.

    What does not turn with the sky is a constant of every baseline, as cross-coupling is, but of all of them by two
    numbers. The power is that in the visibilities, with whatever the antennas make of it at their horizon; they do so
    alike, so that it is real.

    Parameters
    ----------
    azimuths : sequence of float
        Degrees from East through North, from which those that are fitted count; none for an effect that is to be
        scanned.
    """

    kind = "ground_emitter"
    title = "emitters fixed to the ground"
    is_seen_by_beam = False
    unphysical = "a power below zero"

    def __init__(self, azimuths: Sequence[Azimuth] = ()) -> None:
        self.azimuths = tuple(float(azimuth) for azimuth in azimuths)

    def describe(self) -> dict[str, Any]:
        """Return the azimuths."""
        return {"azimuths": list(self.azimuths)}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several times."""
        if len(setup.times) < 2:
            return "what is constant in time shows only at several times; there is one"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return power, and azimuth beyond the candidate's, of every emitter."""
        n = len(self.azimuths)
        names = [f"{called}: {what}" for called in self._called() for what in ("power", "azimuth beyond that")]
        scale = np.tile([1.0, SPACING * resolution(setup) / DEGREE], n)
        trials = max(round(2 * np.pi / resolution(setup)), n) if n else 0
        return Parameters.of(names, ("Jy", "deg") * n, scale, np.repeat(np.arange(n), 2), [False, True] * n, trials)

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return power and azimuth of every emitter, (Nfreqs, n_params)."""
        names = tuple(f"{called}: {what}" for called in self._called() for what in ("power", "azimuth"))
        values = x.copy()
        values[:, 1::2] += self.azimuths
        from_zero = np.tile([True, False], len(self.azimuths))
        return Told(names, ("Jy", "deg") * len(self.azimuths), values, std, from_zero)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return each emitter's fringes, and their change with its azimuth; ``x`` is (n_params,)."""
        fringes, turning = self._fringes(block, x)
        values = np.stack([fringes, x[0::2] * turning * DEGREE], axis=-1).reshape(len(block.groups), len(x))
        return Columns(np.repeat(values[np.newaxis], len(block.times), axis=0), len(x), by_group=True)

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the emitters' visibilities, (Ntimes, Nbls)."""
        values = self._fringes(block, x)[0] @ x[0::2]
        return np.broadcast_to(values[block.member], block.shape).astype(complex)

    def beyond(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> FloatArray:
        """Refuse powers below zero; see `Effect.beyond`."""
        below = np.zeros(x.shape[1])
        below[0::2] = sigmas(-x, std)[:, 0::2].max(axis=0)
        return below

    def without(self, gone: BoolArray) -> tuple[GroundEmitter, IntArray]:
        """Return the other emitters, and the numbers of their parameters, (n_left,); ``gone`` is (n_params,)."""
        stays = np.flatnonzero(~np.any(gone.reshape(-1, 2), axis=1))
        left = GroundEmitter([self.azimuths[number] for number in stays])
        return left, (2 * stays[:, np.newaxis] + np.arange(2)).ravel()

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of azimuths that are looked at."""
        return int(np.ceil(2 * np.pi / (SPACING * resolution(setup))))

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Correlate what is left, summed over time, with an emitter in every direction, each (n_hypotheses, p)."""
        n = self.n_hypotheses(block.setup)
        residual = np.zeros(len(block.groups), dtype=complex)
        np.add.at(residual, block.member, np.sum(block.weights * block.residual, axis=0))
        some = (np.arange(start, min(start + AT_ONCE, n)) for start in range(0, n, AT_ONCE))
        told = [_fringes_from(block, np.deg2rad(_azimuths(n, which))).conj().T @ residual for which in some]
        return np.concatenate(told).real[:, np.newaxis], np.full((n, 1), float(block.weights.sum()))

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> GroundEmitter:
        """Take these azimuths, the best first, leaving out those within a resolution of better ones.

        ``hypotheses`` is (Nchosen,).
        """
        n, chosen = self.n_hypotheses(setup), list[float]()
        apart = resolution(setup) / DEGREE
        for azimuth in _azimuths(n, hypotheses):
            if len(chosen) < AT_MOST and all(abs((azimuth - one + 180) % 360 - 180) >= apart for one in chosen):
                chosen.append(azimuth)
        return GroundEmitter(chosen)

    def alike(self, setup: ObservingSetup, x: FloatArray, element: int) -> Iterator[GroundEmitter]:
        """Return the effect with one of its emitters in grating lobes that are on the horizon, the nearest to it first.

        Lobes within half a resolution of it count: what stands still is told from these by no turn of the sky.
        """
        azimuth = (self.azimuths[element] + float(x[0, 2 * element + 1])) * DEGREE
        lobes = np.array([np.cos(azimuth), np.sin(azimuth)]) + grating_lobes(setup)
        away = np.abs(np.hypot(*lobes.T) - 1)
        for number in np.argsort(away, kind="stable").tolist():
            if away[number] < 0.5 * resolution(setup):
                azimuths = list(self.azimuths)
                azimuths[element] = float(np.arctan2(lobes[number, 1], lobes[number, 0])) / DEGREE % 360
                yield GroundEmitter(azimuths)

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw offsets within half a step; every power is ``strength`` Jy, (n_params,)."""
        parameters = self.parameters(setup)
        x = parameters.scale * rng.uniform(-0.5, 0.5, len(parameters))
        x[0::2] = strength
        return x

    def _called(self) -> list[str]:
        return [f"emitter at azimuth {azimuth:.2f} deg" for azimuth in self.azimuths]

    def _fringes(self, block: RowBlock, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return exp(2 pi i nu b.s/c) of every group and emitter, and its derivative by azimuth, (Ngroups, n)."""
        azimuth = np.asarray(self.azimuths) * DEGREE + x[1::2] * DEGREE
        fringes = _fringes_from(block, azimuth)
        wave = 2j * np.pi * block.freq / C_M_PER_S
        return fringes, wave * (block.vectors[:, :2] @ np.stack([-np.sin(azimuth), np.cos(azimuth)])) * fringes


def _fringes_from(block: RowBlock, azimuth: FloatArray) -> ComplexArray:
    """Return exp(2 pi i nu b.s/c) of every group and azimuth, rad, (Ngroups, n)."""
    wave = 2j * np.pi * block.freq / C_M_PER_S
    return np.exp(wave * (block.vectors[:, :2] @ np.stack([np.cos(azimuth), np.sin(azimuth)])))


def _azimuths(n: int, hypotheses: IntArray) -> list[float]:
    """Return the azimuths of candidates, degrees."""
    azimuths: list[float] = (360 / n * np.asarray(hypotheses)).tolist()
    return azimuths
