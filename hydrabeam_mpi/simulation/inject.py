"""Effects in mock data: what the model lacks, put there on purpose."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.effects import Injected
from hydrabeam_mpi.config.text import toml_value
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.redundancy import RedundantGroups
from hydrabeam_mpi.effects.interface.cross_polarised import CrossPolarised
from hydrabeam_mpi.effects.interface.effect import Cause, Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.registry import REWEIGHTINGS, SEPARATE, make_cause, make_reweighting
from hydrabeam_mpi.effects.shared.displacing import with_displacing
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.setup.skies import source_positions

LONGEST = 80
"""Characters of settings that a line has room for."""

InjectedTruth = dict[str, Any]
Visibilities = Mapping[str, ComplexArray]
"""By polarisation."""


class Injection:
    """Puts effects into simulated visibilities.

    Parameters
    ----------
    job : Job
        With ``[[data.simulate.effects]]``.
    observation : Observation
        With all polarisations that are simulated.
    redundant : RedundantGroups
    sky : Sky
    beams : mapping of str to sequence of callable
        By polarisation the beam of each channel that the array has; the job's own polarisation comes first.
    basis : LinearBasis
        Of the job, and its fits, for effects that speak of them.
    prior_mean : sequence of ndarray
    """

    def __init__(
        self,
        job: Job,
        observation: Observation,
        redundant: RedundantGroups,
        sky: Sky,
        beams: Mapping[str, Sequence[Beam]],
        basis: LinearBasis,
        prior_mean: Sequence[Any],
    ) -> None:
        self.job, self.beams, self.pol = job, beams, next(iter(beams))
        assert job.data.simulate is not None
        self.entries = job.data.simulate.effects
        times: IntArray = np.arange(observation.Ntimes)
        positions = partial(source_positions, job)
        own = replace(observation, pols=(self.pol,))
        self.setup = ObservingSetup(own, redundant, sky, basis, tuple(prior_mean), observation.pols, times, positions)
        self.groups, self.member = np.unique(redundant.group, return_inverse=True)

    def check(self) -> None:
        """Make sure that there are such effects with such parameters.

        Raises
        ------
        InputError
            If not.
        """
        for number, entry in enumerate(self.entries):
            with _told_of(number, entry):
                if entry.kind in REWEIGHTINGS:
                    change, x, rng = self._change(number, entry, 0)
                    rows = self._scene(self.pol, 0, np.zeros((len(self.setup.times), len(self.member)), dtype=complex))
                    change.inject(rows.vis, rows, x, rng)
                else:
                    self._draw(number, entry)

    def before_noise(self, crosses: Visibilities) -> tuple[dict[str, ComplexArray], list[InjectedTruth]]:
        """Return what is measured of visibilities by polarisation, each (Nfreqs, Ntimes, Nbls), and what was put in.

        Both feeds have the same effects, and what is measured so is what causes in other polarisations work on.
        """
        causes: dict[int, tuple[Cause, FloatArray]] = {}
        for number, entry in enumerate(self.entries):
            if entry.kind not in REWEIGHTINGS:
                with _told_of(number, entry):
                    causes[number] = self._draw(number, entry)
        ordinary = {number: (cause, x) for number, (cause, x) in causes.items() if isinstance(cause, Effect)}
        data = {pol: self._with_effects(pol, vis, ordinary) for pol, vis in crosses.items()}
        for kind, separate in SEPARATE.items():
            of_kind = [x for cause, x in causes.values() if cause.kind == kind]
            if of_kind:
                data = self._in_all_polarisations(separate(), data, np.sum(of_kind, axis=0))
        return data, [self._truth(cause, x) for cause, x in causes.values()]

    def _with_effects(
        self, pol: str, crosses: ComplexArray, effects: Mapping[int, tuple[Effect, FloatArray]]
    ) -> ComplexArray:
        """Return C (V + E), (Nfreqs, Ntimes, Nbls)."""
        data = crosses.copy()
        for f in range(len(data)):
            block = with_displacing(self._scene(pol, f, crosses[f]), [(one, x[f]) for one, x in effects.values()])
            added, factor = np.zeros(block.shape, dtype=complex), np.ones(block.shape, dtype=complex)
            block.integrate_for([effect for effect, _ in effects.values()])
            for number, (effect, x) in effects.items():
                with _told_of(number, self.entries[number]), _finite():
                    added += block.added_by(effect, x[f])
                    factor *= effect.factor(block, x[f])
            data[f] = self._as_measured(factor * (block.vis + added))
        return data

    def _in_all_polarisations(
        self, cause: CrossPolarised, copols: Visibilities, x: FloatArray
    ) -> dict[str, ComplexArray]:
        """Return what a cause with parameters (Nfreqs, n_params) makes of each polarisation."""
        channels = [
            cause.measured(self.setup, {pol: vis[f] for pol, vis in copols.items()}, of_channel)
            for f, of_channel in enumerate(x)
        ]
        return {pol: np.array([channel[pol] for channel in channels]) for pol in channels[0]}

    def after_noise(
        self, data: Visibilities, variance: Mapping[str, FloatArray]
    ) -> tuple[Visibilities, list[InjectedTruth]]:
        """Return data with what their weights do not tell; ``variance`` is that of visibilities, (Nfreqs, Ntimes)."""
        noisy, truths = {pol: vis.copy() for pol, vis in data.items()}, []
        for number, entry in enumerate(self.entries):
            if entry.kind not in REWEIGHTINGS:
                continue
            with _told_of(number, entry):
                if not variance:
                    raise InputError(
                        f"'{self.pol}' has no noise here that could differ", remedy="simulate 'ee' or 'nn'"
                    )
                for f in range(len(noisy[self.pol])):
                    change, x, rng = self._change(number, entry, f)
                    for pol, vis in noisy.items():
                        block = self._scene(pol, f, vis[f], 1 / variance[pol][f][:, np.newaxis])
                        own = rng if pol == self.pol else generator(self.job.seed, "injected", number, f, pol)
                        vis[f] = self._as_measured(change.inject(block.vis, block, x, own))
                    truths.append({"kind": change.kind, "channel": f, "values": x.tolist()})
        return noisy, truths

    def _scene(self, pol: str, channel: int, crosses: ComplexArray, weights: FloatArray | float = 1.0) -> RowBlock:
        """Return all rows of a channel; ``weights`` broadcast to (Ntimes, Nbls)."""
        setup = self.setup
        flipped = setup.redundant.flipped
        return RowBlock(
            setup=setup,
            channel=channel,
            times=setup.times,
            bls=np.arange(setup.observation.Nbls),
            groups=self.groups,
            member=self.member,
            positions=source_positions(self.job, setup.sky, setup.observation),
            beam=self.beams.get(pol, self.beams[self.pol])[channel],
            engine_kind=self.job.solver.engine,
            weights=np.broadcast_to(weights, crosses.shape).copy(),
            residual=np.zeros_like(crosses),
            vis=np.where(flipped, crosses.conj(), crosses),
        )

    def _as_measured(self, oriented: ComplexArray) -> ComplexArray:
        """Turn groups' sense back into the baselines' own."""
        return np.where(self.setup.redundant.flipped, oriented.conj(), oriented)

    def _change(
        self, number: int, entry: Injected, channel: int
    ) -> tuple[Reweighting, FloatArray, np.random.Generator]:
        """Make a change of the weights, its parameters in a channel, (n_params,), and what more is drawn from."""
        change, rng = (
            make_reweighting(entry.kind, entry.settings),
            generator(self.job.seed, "injected", number, channel),
        )
        if entry.parameters:
            return change, _by_name(change.neutral(self.setup), entry), rng
        return change, change.draw(self.setup, rng, entry.strength), rng

    def _draw(self, number: int, entry: Injected) -> tuple[Cause, FloatArray]:
        """Make an effect and its parameters, (Nfreqs, n_params)."""
        n_freqs = self.setup.observation.Nfreqs
        cause = make_cause(entry.kind, entry.settings)
        not_applicable = cause.not_applicable(self.setup)
        if not_applicable is not None:
            raise InputError(not_applicable, remedy="remove it")
        if not len(cause.parameters(self.setup)):
            cause = cause.drawn(self.setup, generator(self.job.seed, "injected elements", number))
        if entry.parameters:
            nothing = dict.fromkeys(cause.parameters(self.setup).names, 0.0)
            return cause, np.tile(_by_name(nothing, entry, cause.describe()), (n_freqs, 1))
        keys = [0] * n_freqs if cause.shared else list(range(n_freqs))
        draws = [
            cause.draw(self.setup, generator(self.job.seed, "injected", number, key), entry.strength) for key in keys
        ]
        return cause, np.array(draws)

    def _truth(self, cause: Cause, x: FloatArray) -> InjectedTruth:
        names = cause.parameters(self.setup).names
        return {"kind": cause.kind, "settings": cause.describe(), "names": list(names), "values": x.tolist()}


@contextmanager
def _told_of(number: int, entry: Injected) -> Iterator[None]:
    """Say in which table the input is wrong."""
    try:
        yield
    except InputError as error:
        error.within(f"[[data.simulate.effects]] number {number + 1} ({entry.kind})")
        raise


@contextmanager
def _finite() -> Iterator[None]:
    """Refuse parameters so large that the arithmetic fails.

    Raises
    ------
    InputError
        If a number is not finite any more.
    """
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        message = f"changes the data by more than numbers can tell ({error})"
        raise InputError(message, remedy="lower its strength or parameters") from error


def _by_name(nothing: dict[str, float], entry: Injected, settings: Mapping[str, Any] | None = None) -> FloatArray:
    """Return the parameters that an entry gives by name, the others as in ``nothing``.

    ``settings`` are those by which there are these and no others.
    """
    for name in entry.parameters:
        if name not in nothing:
            near = difflib.get_close_matches(name, nothing, n=3) or list(nothing)[:3]
            remedy = f"there are {', '.join(map(repr, near))} ..." if near else "give those that it has in 'settings'"
            if near and settings:
                remedy += f" by {_settings_text(settings)}; name others there"
            raise InputError(f"no '{name}'", field="parameters", remedy=remedy)
    return np.array(list({**nothing, **entry.parameters}.values()))


def _settings_text(settings: Mapping[str, Any]) -> str:
    """Write settings as a job has them, of long ones their keys alone."""
    text = f"settings = {{ {', '.join(f'{key} = {toml_value(value)}' for key, value in settings.items())} }}"
    return text if len(text) <= LONGEST else f"the settings {', '.join(settings)}"
