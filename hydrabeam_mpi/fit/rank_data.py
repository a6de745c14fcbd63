"""A rank's rows, the design that belongs to them, and the blocks that effects see of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.accumulate import designs
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Estimate, Values
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
from hydrabeam_mpi.model.rime import Beam, ForwardModel
from hydrabeam_mpi.setup.problem import Problem

KEPT_BYTES = 2_000_000_000
"""The design is kept in memory if a rank's share is smaller than this, else computed anew each time."""
ROWS_AT_ONCE = 60_000


@dataclass
class RankData:
    """A rank's fitted or held-out rows.

    Attributes
    ----------
    problem : Problem
        Of the rank group's channels.
    setup : ObservingSetup
        Of all channels.
    rows : Rows
        As read.
    """

    problem: Problem
    setup: ObservingSetup
    rows: Rows
    _plain: list[NDArray[Any]] | None = None
    _kept: list[NDArray[Any]] | None = None
    _kept_for: bytes = b""
    _places: dict[int, tuple[IntArray, FloatArray, FloatArray]] = field(default_factory=dict)
    _memo: dict[tuple[int, str], Any] = field(default_factory=dict)
    _beams: dict[int, CoefficientBeam] = field(default_factory=dict)
    _model: ForwardModel | None = None
    _model_beam: ComplexArray | None = None

    @property
    def model(self) -> ForwardModel:
        """The forward model of the rows' groups, made once."""
        if self._model is None:
            self._model = self.problem.forward_model(self.rows.groups)
        return self._model

    @property
    def model_beam(self) -> ComplexArray:
        """Visibilities of the model beam with nothing fitted, (Nlocal, Ntimes, Ngroups), made once."""
        if self._model_beam is None:
            self._model_beam = self.model.visibilities(self.problem.beams, self.rows.tile.times)
        return self._model_beam

    def noise_variance(self, rows: Rows) -> FloatArray:
        """Return the noise's variance by the weights of calibrated rows, in Jy^2 of the data as they were read.

        The result, (Nlocal, Ntimes, Nbls), is zero where rows do not count.
        """
        power: Any = 1.0 if rows.divisor is None else rows.divisor
        read: Any = 1.0 if self.rows.divisor is None else self.rows.divisor
        used = rows.inv_noise_var > 0
        return np.where(used, power / np.where(used, read * rows.inv_noise_var, 1.0), 0.0)

    @property
    def keeps_designs(self) -> bool:
        """Whether there is room to keep the design rows."""
        n_rows = len(self.rows.groups) * len(self.rows.tile.times) * len(self.rows.data)
        # Those of the sky as it is, and as it is with effects.
        return 2 * n_rows * self.problem.basis.n_modes * 16 <= KEPT_BYTES

    def designs(self, values: Values, show: bool = False) -> Iterator[NDArray[Any]]:
        """Yield the design of each time, (Nfreqs, ..., Ngroups, n_modes), as the function `designs` does.

        Effects that change the sky are part of them.
        """
        key = b"".join(one.x.tobytes() for one in values.active if one.effect.changes_sky)
        if not key:
            yield from self._plain_designs(show)
            return
        if key != self._kept_for:
            self._kept, self._kept_for = None, key
        if self._kept is not None:
            yield from self._kept
            return
        made = []
        for plain, change in zip(self._plain_designs(), self._changes(values), strict=True):
            design = plain + change
            if self.keeps_designs:
                made.append(design)
            yield design
        if self.keeps_designs:
            self._kept = made

    def _plain_designs(self, show: bool = False) -> Iterator[NDArray[Any]]:
        """Yield the design rows of the sky as it is, which are made once where there is room to keep them."""
        if self._plain is not None:
            yield from self._plain
            return
        made = []
        for design in designs(self.rows, self.model, self.problem.basis, "design matrix", show):
            if self.keeps_designs:
                made.append(design)
            yield design
        if self.keeps_designs:
            self._plain = made

    def _changes(self, values: Values) -> Iterator[NDArray[Any]]:
        """Yield what effects change of the design rows: of sources whose flux they change, and of further ones."""
        basis, engine = self.problem.basis, self.model.engine
        for t, time in enumerate(self.rows.tile.times.tolist()):
            by_channel = []
            for channel in range(len(self.rows.data)):
                block = self.block(channel, slice(t, t + 1), _no_beam, values)
                sources = block.sources(time)
                change = sources.flux_without() - sources.flux
                changed = np.flatnonzero(change)
                sky = [(sources.za[changed], sources.az[changed], change[changed])]
                sky += [more for one, x in block.sky_effects if (more := one.extra_sky(block, time, x)) is not None]
                za, az, flux = (np.concatenate(parts) for parts in zip(*sky, strict=True))
                by_channel.append(engine.design(basis, za, az, flux[np.newaxis], np.array([block.freq]))[0])
            mixed = basis.mix(np.array(by_channel))
            yield mixed[:, 0] + 1j * mixed[:, 1] if basis.is_complex else mixed

    def row_blocks(
        self, channel: int, at: Estimate, added: ComplexArray, rows: Rows
    ) -> Iterator[tuple[slice, RowBlock, NDArray[Any]]]:
        """Yield blocks of times of one channel with the current model and its design rows.

        Parameters
        ----------
        channel : int
            Among those of the rank group.
        at : Estimate
            The model.
        added : ndarray of complex, (Ntimes, Nbls)
            E of this channel.
        rows : Rows
            Calibrated; see `calibrated`.
        """
        posterior = at.beams[channel]
        times = self.rows.tile.times
        step = max(1, ROWS_AT_ONCE // max(len(self.rows.tile.bls), 1))
        held: list[NDArray[Any]] = []
        for t, design in enumerate(self.designs(at.values)):
            held.append(design[channel])
            if len(held) < step and t + 1 < len(times):
                continue
            span = slice(t + 1 - len(held), t + 1)
            rows_of_design = np.array(held)
            held = []
            beam_alone = _visibilities(rows_of_design, posterior)[:, self.rows.member]
            block = self.block(
                channel,
                span,
                self._beam(channel, posterior),
                at.values,
                vis=beam_alone + added[span],
                weights=rows.inv_noise_var[channel, span],
                residual=rows.data[channel, span] - beam_alone,
                design=rows_of_design,
            )
            yield span, block, rows_of_design

    def _beam(self, channel: int, posterior: Posterior) -> CoefficientBeam:
        """Return the mean beam of a channel of the rank group; the same object, with its table, for the same mean."""
        kept = self._beams.get(channel)
        if kept is not None and np.array_equal(kept.coeffs, posterior.mean):
            return kept
        observation = self.problem.observation
        info = BeamInfo("inferred", float(observation.freqs[channel]), observation.pols[0])
        self._beams[channel] = CoefficientBeam(self.problem.basis, posterior.mean, info)
        return self._beams[channel]

    def block(self, channel: int, span: slice, beam: Beam, values: Values, **data: Any) -> RowBlock:
        """Return the block of some of the rank's times; ``data`` are fields of `RowBlock` about its rows."""
        number = int(self.problem.channel_numbers[channel])
        room = self.setup.sky.Nsrc * len(self.rows.tile.times) * 24 <= KEPT_BYTES / 4
        return RowBlock(
            setup=self.setup,
            channel=number,
            times=self.rows.tile.times[span],
            bls=self.rows.tile.bls,
            groups=self.rows.groups,
            member=self.rows.member,
            positions=self.model.positions,
            beam=beam,
            engine_kind=self.problem.job.solver.engine,
            places=self._places if room else None,
            sky_effects=[(one.effect, one.x[number]) for one in values.active if one.effect.changes_sky],
            memo=self._memo if self.keeps_designs else None,
            **data,
        )

    def effects(self, at: Estimate) -> tuple[ComplexArray, ComplexArray]:
        """Return C and E of all rows, each (Nfreqs, Ntimes, Nbls)."""
        factor = np.ones(self.rows.data.shape, dtype=complex)
        added = np.zeros_like(factor)
        others = [one for one in at.values.active if not one.effect.changes_sky]
        adding = [one.effect for one in others if not one.effect.multiplies]
        for channel, number in enumerate(self.problem.channel_numbers.tolist() if others else ()):
            for span, block, _ in self.row_blocks(channel, at, added[channel], self.rows):
                block.integrate_for(adding)
                for one in others:
                    if one.effect.multiplies:
                        factor[channel, span] *= one.effect.factor(block, one.x[number])
                    else:
                        added[channel, span] += one.effect.added(block, one.x[number])
        return factor, added

    def calibrated(self, at: Estimate) -> tuple[Rows, ComplexArray]:
        """Return the rows with the effects removed, d/C - E with weights w |C|^2, and E, (Nfreqs, Ntimes, Nbls)."""
        factor, added = self.effects(at)
        power = np.abs(factor) ** 2
        usable = power > 1e-12
        data = np.where(usable, self.rows.data / np.where(usable, factor, 1.0), 0.0) - added
        weights = np.where(usable, self.rows.inv_noise_var * power, 0.0)
        divisor = power if self.rows.divisor is None else power * self.rows.divisor
        rows = replace(self.rows, data=data, inv_noise_var=weights, divisor=divisor)
        if at.values.reweighted:
            weights = rows.inv_noise_var.copy()
            for channel, number in enumerate(self.problem.channel_numbers.tolist()):
                for span, block, _ in self.row_blocks(channel, at, added[channel], rows):
                    for one in at.values.reweighted:
                        # One after the other: a threshold is about weights that the others have changed already.
                        block.weights = block.weights * one.change.weight_factor(block, one.x[number])
                    weights[channel, span] = block.weights
            rows = replace(rows, inv_noise_var=weights)
        return rows, added


def _no_beam(za: FloatArray, az: FloatArray) -> FloatArray:
    """Stand in for a beam that nobody asks for."""
    return np.zeros(len(za))


def _visibilities(block: NDArray[Any], posterior: Posterior) -> ComplexArray:
    """Return A b, (Ntimes, Ngroups)."""
    if posterior.is_complex:
        return np.asarray(block @ posterior.mean)
    parts = block @ posterior.mean
    return np.asarray(parts[:, 0] + 1j * parts[:, 1])
