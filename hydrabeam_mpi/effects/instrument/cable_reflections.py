"""Reflections in the antennas' cables: V_jk -> g_j g_k* V_jk with g = 1 + z exp(2 pi i (nu - nu_0) tau)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.antenna_delays import NS
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.effects.shared.per_antenna import antennas_named, row_antennas

MIN_CHANNELS = 4
MAX_ECHOES = 16
"""Most candidates of one antenna that are compared together; one faulty antenna would otherwise crowd out all
others.
"""
NO_PHASE = np.pi / np.sqrt(3)
"""Standard deviation of a phase that is anything, rad."""
ECHO_STEPS = 6  # of Gauss and Newton from a delay that was scanned to an echo; each about squares what is left
STEPS_APART = 2  # of the delays scanned: a resolution


class CableReflections(ScannedEffect):
    """Echoes of an antenna's own signal, each with its delay tau and complex amplitude z, the same at all channels.

    Several echoes of one antenna add up. The phase of z is that at the mean frequency nu_0 of the channels, so that it
    hardly depends on the delay: g = 1 + A exp(2 pi i nu tau + i phi) has z = A exp(2 pi i nu_0 tau + i phi). An echo
    comes late, tau > 0; early ones are candidates as well, as visibilities are complex and tell the two apart.

    The candidates are all antennas times all delays, of both signs, in steps of half the resolution 1/bandwidth. They
    begin at one resolution, below which an echo is a gain that varies smoothly with frequency, and end at the
    1/(2 dnu) from which on the channels' spacing dnu no longer tells one delay from another.

    Parameters
    ----------
    reflections : sequence of (antenna number, delay in ns)
        The echoes; none for an effect that is to be scanned.
    """

    kind = "cable_reflections"
    title = "cable reflections"
    multiplies = True
    shared = True

    def __init__(self, reflections: Sequence[Sequence[float]] = ()) -> None:
        self.reflections = tuple((int(number), float(delay)) for number, delay in reflections)

    def describe(self) -> dict[str, Any]:
        """Return the antennas and delays (ns)."""
        return {"reflections": [list(reflection) for reflection in self.reflections]}

    def carried_over(self, setup: ObservingSetup) -> CableReflections:
        """Return the echoes of those of the antennas that other data have."""
        there = setup.observation.antenna_numbers[setup.antennas_in_use].tolist()
        return CableReflections([echo for echo in self.reflections if echo[0] in there])

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for enough channels to tell a ripple from a slope."""
        n_channels = len(np.unique(setup.observation.freqs))
        if n_channels >= MIN_CHANNELS:
            return None
        return (
            f"a reflection is a ripple of the gain along frequency, which needs {MIN_CHANNELS} channels or more; "
            f"with {n_channels} it is no different from a gain of each channel"
        )

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return Re z, Im z and how far the delay lies beyond the candidate's, for every echo."""
        self._antennas(setup)
        names, units, scale = [], [], []
        for number, delay in self.reflections:
            echo = _echo(number, delay)
            names += [f"{echo} real", f"{echo} imaginary", f"{echo} delay beyond that"]
            units += ["", "", "ns"]
            scale += [0.01, 0.01, _resolution(setup)]
        n = len(self.reflections)
        trials = max(self.n_hypotheses(setup), n)
        return Parameters.of(
            names, units, np.array(scale), np.repeat(np.arange(n), 3), [False, False, True] * n, trials
        )

    def refined(self, x: FloatArray, used: IntArray) -> tuple[CableReflections, FloatArray, IntArray]:
        """Return the echoes in use with the delays that have been found, nothing beyond them left, (Nfreqs, n_left)."""
        echoes = np.unique(used // 3)
        left = (3 * echoes[:, np.newaxis] + np.arange(3)).ravel()
        part = x[:, left]
        delays = [self.reflections[n][1] + float(x[0, 3 * n + 2]) for n in echoes]
        part[:, 2::3] = 0.0
        return CableReflections([(self.reflections[n][0], delays[k]) for k, n in enumerate(echoes)]), part, left

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return amplitude, phase (at the mean frequency) and delay of every echo."""
        refined, left, _ = self.refined(x, np.arange(x.shape[1]))
        each = {"amplitude": "", "phase": "rad", "delay": "ns"}
        values, errors = left.reshape(len(x), -1, 3), std.copy().reshape(len(x), -1, 3)
        amplitude = np.hypot(values[..., 0], values[..., 1])
        phase = np.angle(values[..., 0] + 1j * values[..., 1])
        turn = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        along, aside = (np.linalg.norm(one * errors[..., :2], axis=-1) for one in (turn, turn[..., ::-1]))
        phase_known = amplitude > aside / NO_PHASE
        errors[..., 1] = np.where(phase_known, aside / np.where(phase_known, amplitude, 1.0), NO_PHASE)
        values[..., 0], values[..., 1], errors[..., 0] = amplitude, phase, along
        values[..., 2] = [delay for _, delay in refined.reflections]
        n = len(self.reflections)
        names = tuple(f"{_echo(*reflection)}: {what}" for reflection in refined.reflections for what in each)
        from_zero = np.tile([True, False, False], n)
        return Told(names, tuple(each.values()) * n, values.reshape(x.shape), errors.reshape(x.shape), from_zero)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return m d ln g for the echoes of a row's first antenna, and m (d ln g)* for those of its second.

        ``x`` is (n_params,).
        """
        n = len(self.reflections)
        if not n:
            return Columns(np.zeros((*block.shape, 0), dtype=complex), 0)
        antennas = self._antennas(block.setup)
        amplitudes, waves = self._echoes(_offset(block), x)
        turn = 2j * np.pi * _offset(block) * NS
        slopes = np.stack([waves, 1j * waves, turn * amplitudes * waves], axis=-1)
        slopes /= self.gains(block.setup, block.channel, x)[antennas, np.newaxis]

        echoes = _echoes_by_antenna(antennas, len(block.setup.observation.antenna_numbers))
        first, second = echoes[block.ant1], echoes[block.ant2]
        sides = np.concatenate([slopes[first], slopes[second].conj()], axis=1)
        both = np.concatenate([first, second], axis=1)
        sides[both < 0] = 0.0
        index = 3 * np.maximum(both, 0)[..., np.newaxis] + np.arange(3)
        n_rows = len(block.bls)
        values = block.vis[..., np.newaxis] * sides.reshape(n_rows, -1)
        return Columns(values, 3 * n, index.reshape(n_rows, -1))

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return g_j g_k*, (Ntimes, Nbls)."""
        gains = self.gains(block.setup, block.channel, x)
        return np.broadcast_to(gains[block.ant1] * gains[block.ant2].conj(), block.shape)

    def n_hypotheses(self, setup: ObservingSetup) -> int:
        """Return the number of antennas times that of delays."""
        return len(setup.antennas_in_use) * len(candidate_delays(setup))

    def scan(self, block: RowBlock) -> tuple[FloatArray, FloatArray]:
        """Return the sums for Re z and Im z of every candidate, (n_hypotheses, 2), antenna by antenna."""
        first, second = row_antennas(block).T
        told = np.sum(block.weights * block.vis.conj() * block.residual, axis=0)
        power = np.sum(block.weights * np.abs(block.vis) ** 2, axis=0)
        n = len(block.setup.antennas_in_use)
        # An echo enters the rows of which its antenna is the second conjugated.
        sums = _sum_by(first, told, n) + _sum_by(second, told, n).conj()
        norms = np.bincount(first, power, n) + np.bincount(second, power, n)
        waves = np.exp(2j * np.pi * _offset(block) * NS * candidate_delays(block.setup))
        products = np.outer(sums, waves.conj()).reshape(-1)
        power = np.repeat(norms, len(waves))
        return np.stack([products.real, products.imag], axis=-1), np.stack([power, power], axis=-1)

    def at(self, setup: ObservingSetup, hypotheses: IntArray) -> CableReflections:
        """Return the effect with these echoes, of each antenna with the first few alone, none beside a better one.

        ``hypotheses`` is (Nchosen,).

        Delays are refined later, so that echoes within a resolution of each other would become the same.
        """
        delays = candidate_delays(setup)
        numbers = setup.observation.antenna_numbers[setup.antennas_in_use]
        antenna, delay = np.divmod(np.asarray(hypotheses, dtype=int), len(delays))
        kept_places: list[int] = []
        for place in range(len(antenna)):
            near = [other for other in kept_places if antenna[other] == antenna[place]]
            if all(abs(int(delay[other]) - int(delay[place])) > STEPS_APART for other in near):
                kept_places.append(place)
        antenna, delay = antenna[kept_places], delay[kept_places]
        kept = _echoes_by_antenna(antenna, len(numbers))[:, :MAX_ECHOES]
        kept = np.sort(kept[kept >= 0])
        return CableReflections(list(zip(numbers[antenna[kept]].tolist(), delays[delay[kept]].tolist(), strict=True)))

    def _antennas(self, setup: ObservingSetup) -> IntArray:
        """Return the index of each echo's antenna; the observation must have it."""
        return antennas_named(setup, [number for number, _ in self.reflections], "reflections")

    def _echoes(self, offset: float, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return z and exp(2 pi i (nu - nu_0) tau) of every echo."""
        delays = np.array([delay for _, delay in self.reflections]) + x[2::3]
        return x[0::3] + 1j * x[1::3], np.exp(2j * np.pi * offset * NS * delays)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return one plus the echoes of every antenna, (Nants,)."""
        amplitudes, waves = self._echoes(float(setup.observation.freqs[channel]) - setup.reference_freq, x)
        return 1.0 + _sum_by(self._antennas(setup), amplitudes * waves, setup.observation.Nants)


def _echo(number: int, delay: float) -> str:
    """Return what an echo of an antenna is called; the delay is in ns."""
    return f"antenna {number} reflection at {delay:.1f} ns"


def candidate_delays(setup: ObservingSetup) -> FloatArray:
    """Return the delays that are scanned, ns, ascending; of the two aliases at the Nyquist limit the positive one.

    The result is (Ndelays,).
    """
    if len(np.unique(setup.observation.freqs)) < MIN_CHANNELS:
        return np.zeros(0)
    limit = 0.5 / (NS * np.diff(np.unique(setup.observation.freqs)).min())
    step = _resolution(setup) / 2
    slack = 1e-6  # steps, for the rounding of frequencies
    steps = np.arange(2, np.floor(limit / step + slack) + 1)
    early = steps[steps < limit / step - slack]
    return step * np.concatenate([-early[::-1], steps])


def echoes_of(setup: ObservingSetup, gains: ComplexArray) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Return the echo that comes nearest to each antenna's gains in all channels, and the gains that it makes.

    Parameters
    ----------
    setup : ObservingSetup
    gains : ndarray of complex, (Nfreqs, Nants)

    Returns
    -------
    delays : ndarray, (Nants,)
        ns, each from the best of those that are scanned.
    amplitudes : ndarray of complex, (Nants,)
    made : ndarray of complex, (Nfreqs, Nants)
    """
    turns = 2j * np.pi * NS * (setup.observation.freqs - setup.reference_freq)[:, np.newaxis]
    scanned = candidate_delays(setup)
    projected = np.exp(-turns * scanned).T @ (gains - 1) / len(turns)
    best = np.argmax(np.abs(projected), axis=0)
    delays, amplitudes = scanned[best], projected[best, np.arange(gains.shape[1])]
    for _ in range(ECHO_STEPS):
        waves = np.exp(turns * delays)
        for k, (wave, left) in enumerate(zip(waves.T, (gains - 1 - amplitudes * waves).T, strict=True)):
            columns = np.stack([wave, 1j * wave, turns[:, 0] * amplitudes[k] * wave], axis=-1)
            step = np.linalg.lstsq(
                np.concatenate([columns.real, columns.imag]), np.concatenate([left.real, left.imag])
            )[0]
            amplitudes[k] += step[0] + 1j * step[1]
            delays[k] += np.clip(step[2], -0.5 * _resolution(setup), 0.5 * _resolution(setup))
    return delays, amplitudes, 1 + amplitudes * np.exp(turns * delays)


def _resolution(setup: ObservingSetup) -> float:
    """Return 1/bandwidth in ns, with one spacing added to what lies between the first and the last channel."""
    freqs = np.unique(setup.observation.freqs)
    spacing = np.diff(freqs).min() if len(freqs) > 1 else setup.observation.channel_width[0]
    return float(1 / (NS * (freqs[-1] - freqs[0] + spacing)))


def _offset(block: RowBlock) -> float:
    """Return nu - nu_0, Hz."""
    return block.freq - block.setup.reference_freq


def _sum_by(place: IntArray, values: ComplexArray, n: int) -> ComplexArray:
    """Add up complex values by place, (n,)."""
    return np.bincount(place, values.real, n) + 1j * np.bincount(place, values.imag, n)


def _echoes_by_antenna(antennas: IntArray, n_antennas: int) -> IntArray:
    """Return which echoes each antenna has, (Nants, most), padded with -1."""
    counts = np.bincount(antennas, minlength=n_antennas)
    order = np.argsort(antennas, kind="stable")
    starts = np.cumsum(counts) - counts
    echoes = np.full((n_antennas, int(counts.max())), -1)
    echoes[antennas[order], np.arange(len(order)) - starts[antennas[order]]] = order
    return echoes
