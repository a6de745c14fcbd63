"""Effects in mock data: what the model lacks, put there on purpose."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.effects import Injected
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.redundancy import RedundantGroups
from hydrabeam_mpi.effects.base import Effect
from hydrabeam_mpi.effects.catalogue import EFFECTS, REWEIGHTINGS, make_effect, make_reweighting
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.basis import LinearBasis
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.skies import source_positions

Truth = dict[str, Any]


class Injection:
    """Puts effects into simulated visibilities.

    Parameters
    ----------
    job : Job
        With ``[[data.simulate.effects]]``.
    observation : Observation
    redundant : RedundantGroups
    sky : Sky
    beams : sequence of callable
        The beam of each channel that the array has.
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
        beams: Sequence[Beam],
        basis: LinearBasis,
        prior_mean: Sequence[Any],
    ) -> None:
        self.job, self.beams = job, beams
        assert job.data.simulate is not None
        self.entries = job.data.simulate.effects
        times: IntArray = np.arange(observation.Ntimes)
        pols = observation.pols
        positions = partial(source_positions, job)
        self.experiment = Experiment(observation, redundant, sky, basis, tuple(prior_mean), pols, times, positions)
        self.groups, self.member = np.unique(redundant.group, return_inverse=True)

    def before_noise(self, crosses: ComplexArray) -> tuple[ComplexArray, list[Truth]]:
        """Return C (V + E) and what was put in, (Nfreqs, Ntimes, Nbls)."""
        data = crosses.copy()
        ordinary: list[tuple[Effect, FloatArray]] = []
        for number, entry in enumerate(self.entries):
            if entry.kind not in REWEIGHTINGS:
                with _told_of(number, entry):
                    ordinary.append(self._draw(number, entry))
        for f in range(len(data)):
            scene = self._scene(f, crosses[f])
            added, factor = np.zeros(scene.shape, dtype=complex), np.ones(scene.shape, dtype=complex)
            scene.integrate_for([effect for effect, _ in ordinary])
            for effect, x in ordinary:
                added += effect.added(scene, x[f])
                factor *= effect.factor(scene, x[f])
            data[f] = self._as_measured(factor * (scene.vis + added))
        return data, [self._truth(effect, x) for effect, x in ordinary]

    def after_noise(self, data: ComplexArray, variance: FloatArray) -> tuple[ComplexArray, list[Truth]]:
        """Return data with what their weights do not tell; ``variance`` is that of a visibility, (Nfreqs, Ntimes)."""
        noisy, truths = data.copy(), []
        for number, entry in enumerate(self.entries):
            if entry.kind not in REWEIGHTINGS:
                continue
            with _told_of(number, entry):
                change = make_reweighting(entry.kind, entry.settings)
                for f in range(len(noisy)):
                    scene = self._scene(f, noisy[f])
                    scene.weights = np.broadcast_to(1 / variance[f][:, np.newaxis], scene.shape).copy()
                    rng = generator(self.job.seed, "injected", number, f)
                    if entry.parameters:
                        x = _by_name(change.neutral(self.experiment), entry)
                    else:
                        x = change.draw(self.experiment, rng, entry.strength)
                    noisy[f] = self._as_measured(change.inject(scene.vis, scene, x, rng))
                    truths.append({"kind": change.kind, "channel": f, "values": x.tolist()})
        return noisy, truths

    def _scene(self, channel: int, crosses: ComplexArray) -> Scene:
        experiment = self.experiment
        flipped = experiment.redundant.flipped
        scene = Scene(
            experiment=experiment,
            channel=channel,
            times=experiment.times,
            bls=np.arange(experiment.observation.Nbls),
            groups=self.groups,
            member=self.member,
            positions=source_positions(self.job, experiment.sky, experiment.observation),
            beam=self.beams[channel],
            engine_kind=self.job.solver.engine,
            vis=np.where(flipped, crosses.conj(), crosses),
        )
        scene.weights = np.ones(scene.shape)
        scene.residual = np.zeros(scene.shape, dtype=complex)
        return scene

    def _as_measured(self, oriented: ComplexArray) -> ComplexArray:
        """Turn groups' sense back into the baselines' own."""
        return np.where(self.experiment.redundant.flipped, oriented.conj(), oriented)

    def _draw(self, number: int, entry: Injected) -> tuple[Effect, FloatArray]:
        """Make an effect and its parameters, (Nfreqs, n_params)."""
        n_freqs = self.experiment.observation.Nfreqs
        if entry.kind not in EFFECTS:
            raise InputError("cannot be simulated in one polarisation alone", remedy="remove it")
        effect = make_effect(entry.kind, entry.settings)
        refusal = effect.refusal(self.experiment)
        if refusal is not None:
            raise InputError(refusal, remedy="remove it")
        if not entry.settings:
            effect = effect.drawn(self.experiment, generator(self.job.seed, "injected elements", number))
        if entry.parameters:
            nothing = dict.fromkeys(effect.parameters(self.experiment).names, 0.0)
            return effect, np.tile(_by_name(nothing, entry), (n_freqs, 1))
        keys = [0] * n_freqs if effect.shared else list(range(n_freqs))
        draws = [
            effect.draw(self.experiment, generator(self.job.seed, "injected", number, key), entry.strength)
            for key in keys
        ]
        return effect, np.array(draws)

    def _truth(self, effect: Effect, x: FloatArray) -> Truth:
        names = effect.parameters(self.experiment).names
        return {"kind": effect.kind, "settings": effect.describe(), "names": list(names), "values": x.tolist()}


@contextmanager
def _told_of(number: int, entry: Injected) -> Iterator[None]:
    """Say in which table the input is wrong."""
    try:
        yield
    except InputError as error:
        error.within(f"[[data.simulate.effects]] number {number + 1} ({entry.kind})")
        raise


def _by_name(nothing: dict[str, float], entry: Injected) -> FloatArray:
    """Return the parameters that an entry gives by name, the others as in ``nothing``."""
    for name in entry.parameters:
        if name not in nothing:
            near = difflib.get_close_matches(name, nothing, n=3) or list(nothing)[:3]
            remedy = f"there are {', '.join(map(repr, near))} ..." if near else "give those that it has in 'settings'"
            raise InputError(f"no '{name}'", field="parameters", remedy=remedy)
    return np.array(list({**nothing, **entry.parameters}.values()))
