"""Mock data as in HDBI II, section 3, from any array, sky and beam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from astropy import units
from astropy.coordinates import EarthLocation
from astropy.time import Time

from hydrabeam_mpi.config import Job, Simulate
from hydrabeam_mpi.config.sizes import check_fits, simulated_bytes
from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import (
    C_M_PER_S,
    EARTH_RATE,
    SIDEREAL_DAY,
    ComplexArray,
    FloatArray,
    IntArray,
    Observation,
    are_copolar,
)
from hydrabeam_mpi.data.partition import make_tiles
from hydrabeam_mpi.data.redundancy import RedundantGroups, check_apart, check_tolerance, find_redundant_groups
from hydrabeam_mpi.effects.interface.observing_setup import FEEDS
from hydrabeam_mpi.effects.registry import SEPARATE
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.disk import check_space, writing
from hydrabeam_mpi.io.finite import SIMULATION, check_finite
from hydrabeam_mpi.io.truth_file import Truth, write_truth
from hydrabeam_mpi.io.uvdata import feeds_of
from hydrabeam_mpi.io.uvwrite import write_uvh5
from hydrabeam_mpi.memory import machine_bytes
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.model.engines import make_engine
from hydrabeam_mpi.model.engines.smearing import mean_steps, smearing_of
from hydrabeam_mpi.model.rime import ForwardModel
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.mpi import Comm, bcast_object, memory_per_rank, together
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.result.summary import GRID_AZ, GRID_ZA, evaluate_on_grid
from hydrabeam_mpi.setup.beams import TurnedBeam, fit_model_beams, load_beams, perturb
from hydrabeam_mpi.setup.earth_table import share_earth_table
from hydrabeam_mpi.setup.skies import count_sources, load_sky, source_positions
from hydrabeam_mpi.simulation.arrays import hexagon, read_layout
from hydrabeam_mpi.simulation.inject import InjectedTruth, Injection, Visibilities
from hydrabeam_mpi.terminal.progress import say


@dataclass(frozen=True)
class Scene:
    """What a simulation observes.

    Attributes
    ----------
    observation : Observation
    sky : Sky
        The whole sky, of which a model may leave faint sources out.
    beams : dict of str to tuple of callable
        The true beam of each channel, by polarisation.
    """

    observation: Observation
    sky: Sky
    beams: dict[str, tuple[Beam, ...]]


def simulate_to(world: Comm, job: Job, folder: Path) -> Scene:
    """Write ``data.uvh5`` and ``truth.h5`` into ``folder`` and return what has been observed.

    Collective: all ranks of `world`, which share out the times.

    Raises
    ------
    InputError
        On all ranks, if the job cannot be simulated.
    """
    assert job.data.simulate is not None
    scene, memory = None, memory_per_rank(world)
    with together(world):
        if world.rank == 0:
            say("simulating")
            scene = _set_scene(job, job.data.simulate, memory)
            check_space(folder, _least_bytes(scene.observation))
    scene = bcast_object(world, scene)
    share_earth_table(world)
    observation, sky, beams = scene.observation, scene.sky, scene.beams
    with together(world):
        redundant = find_redundant_groups(
            observation.bl_vectors, job.data.redundancy_tol, either_sign=are_copolar(beams)
        )
        check_tolerance(observation, redundant, job.data.redundancy_tol)
        vectors = np.concatenate([redundant.vectors, np.zeros((1, 3))])
        alone = np.zeros(1, dtype=int)
        costs = count_sources(sky, observation)
        tiles = make_tiles(np.arange(observation.Ntimes), costs, alone, alone, world.size)
        times = tiles[world.rank].times
        part = {pol: _visibilities(job, scene, vectors, own, times) for pol, own in beams.items()}
    parts = world.gather(part)
    with together(world):
        if parts is not None:
            unique = {pol: np.concatenate([of_rank[pol] for of_rank in parts], axis=1) for pol in beams}
            with writing(folder):
                _write(folder, job, observation, redundant, sky, beams, unique)
    return scene


def check_effects(job: Job) -> None:
    """Make sure that the effects of a job can be put into its mock data, without simulating any. Serial.

    Raises
    ------
    InputError
        If one cannot be.
    """
    settings = job.data.simulate
    if settings is not None and settings.effects:
        scene = _set_scene(job, settings, machine_bytes())
        observation, beams = scene.observation, scene.beams
        redundant = find_redundant_groups(
            observation.bl_vectors, job.data.redundancy_tol, either_sign=are_copolar(beams)
        )
        _injection(job, observation, redundant, scene.sky, beams).check()


def _visibilities(
    job: Job, scene: Scene, vectors: FloatArray, beams: tuple[Beam, ...], times: IntArray
) -> ComplexArray:
    """Simulate the visibilities of some times, (Nfreqs, len(times), Nvectors), Jy; means over integrations if asked."""
    observation, sky = scene.observation, scene.sky
    smearing = smearing_of(observation)
    steps = [(0.0, 1.0)]
    if smearing is not None:
        turns = float(np.linalg.norm(smearing.turn) * observation.freqs.max()) / C_M_PER_S
        steps, smearing = mean_steps(vectors, turns), replace(smearing, turn=(0.0, 0.0, 0.0))
    engine = make_engine(job.solver.engine, vectors, observation.antpos, smearing)
    mean = np.zeros((observation.Nfreqs, len(times), len(vectors)), dtype=complex)
    for step, weight in steps:
        later = step * observation.integration_time
        instants = replace(
            observation, times=observation.times + later / 86400, lsts=observation.lsts + EARTH_RATE * later
        )
        model = ForwardModel(source_positions(job, sky, instants), sky.flux, observation.freqs, engine)
        mean += weight * model.visibilities(beams, times)
    return mean


def _set_scene(job: Job, settings: Simulate, memory: int) -> Scene:
    """Lay out what is observed, with which sky, and with which beams in which polarisations."""
    pols: tuple[str, ...] = job.data.polarization
    if settings.effects and len(pols) > 1:
        told, remedy = f"has {len(pols)} polarisations, and effects are simulated in one", f'set it to "{pols[0]}"'
        raise InputError(told, field="[data] polarization", remedy=remedy)
    # Noise is that of the autocorrelations of both feeds, which have beams of their own.
    autos = [2 * feed for pol in pols if not are_copolar([pol]) for feed in pol]
    observation = replace(
        mock_observation(settings, pols[0]),
        pols=tuple(dict.fromkeys([*pols, *autos])),
        is_smeared=job.data.smearing,
    )
    needed = simulated_bytes(observation.Nants, observation.Ntimes, observation.Nfreqs)
    check_fits("[data.simulate]", needed, memory)
    check_apart(observation, job.data.redundancy_tol)
    beams = {one: load_beams(job, observation.freqs, one) for one in observation.pols}
    if settings.perturb is not None:
        change = partial(perturb, job, settings=settings.perturb)
        beams = {one: tuple(map(change, own)) for one, own in beams.items()}
    own, pol = beams[pols[0]], pols[0]
    if observation.is_copolar and any(entry.kind in SEPARATE for entry in settings.effects):
        one, other = next(feeds for feeds in FEEDS if pol[0] in feeds)
        observation = replace(observation, pols=(2 * one, 2 * other, one + other, other + one))
        second = 2 * (other if pol[0] == one else one)
        beams[second] = tuple(TurnedBeam(beam, second) for beam in own)
    return Scene(observation, load_sky(job, observation), beams)


def _least_bytes(observation: Observation) -> int:
    """Return how many bytes the visibilities have, the autocorrelations included."""
    n_bls = observation.Nbls + observation.Nants
    return observation.Ntimes * n_bls * observation.Nfreqs * observation.Npols * np.dtype(complex).itemsize


def mock_observation(settings: Simulate, pol: str) -> Observation:
    """Lay out array, channels and times: evenly spaced in sidereal time from the first LST, the last excluded.

    All nights have the same ones.
    """
    array = settings.array
    layout = read_layout(array.file) if array.file else hexagon(*array.hex, array.spacing)
    location = EarthLocation.from_geodetic(
        settings.longitude * units.deg, settings.latitude * units.deg, settings.height * units.m
    )
    first, last = settings.lst_range
    span = (last - first) % 24 or 24.0
    wait = (first - _lst_hours(settings.start, location)) % 24
    hours = wait + span * np.arange(settings.n_times) / settings.n_times
    hours = (24 * np.arange(settings.nights)[:, np.newaxis] + hours).ravel()
    times = settings.start + hours / 24 * SIDEREAL_DAY
    n_freqs = len(settings.freqs)
    one, two = np.triu_indices(len(layout.numbers), 1)
    return Observation(
        telescope_name="hydrabeam mock",
        location=location,
        antenna_numbers=layout.numbers,
        antenna_names=layout.names,
        antpos=layout.antpos,
        antpairs=np.stack([layout.numbers[one], layout.numbers[two]], axis=1),
        freqs=np.array(settings.freqs),
        channel_width=np.full(n_freqs, settings.channel_width),
        times=times,
        lsts=np.deg2rad(15 * _lst_hours(times, location)),
        integration_time=np.full(len(times), settings.integration_time),
        pols=(pol,),
    )


def _lst_hours(times: FloatArray | float, location: EarthLocation) -> FloatArray:
    """Local apparent sidereal time in hours."""
    return np.asarray(Time(times, format="jd", location=location).sidereal_time("apparent").hour)


def radiometer_variance(
    autos: Mapping[str, FloatArray], observation: Observation, nsamples: float
) -> dict[str, FloatArray]:
    """sigma^2 = V_jj V_kk / (dt dnu) of identical antennas (HDBI II, eq. 23), (Nfreqs, Ntimes) by polarisation."""
    samples = nsamples * observation.channel_width[:, np.newaxis] * observation.integration_time
    return {pol: autos[2 * pol[0]] * autos[2 * pol[1]] / samples for pol in observation.pols}


def add_noise(data: ComplexArray, variance: FloatArray, seed: int, *key: str) -> ComplexArray:
    """Add circular Gaussian noise to (Nfreqs, Ntimes, Nbls), drawn so that no rank count changes it."""
    noisy = data.copy()
    for f, t in np.ndindex(variance.shape):
        noise = complex_normal(generator(seed, "noise", f, t, *key), (data.shape[2],))
        noisy[f, t] += noise * np.sqrt(variance[f, t])
    return noisy


def _write(
    folder: Path,
    job: Job,
    observation: Observation,
    redundant: RedundantGroups,
    sky: Sky,
    beams: Mapping[str, tuple[Beam, ...]],
    unique: Mapping[str, ComplexArray],
) -> None:
    """Add noise and write the data and the truth. The last of the unique baselines is an antenna with itself."""
    settings = job.data.simulate
    assert settings is not None
    crosses = {pol: vis[:, :, redundant.group] for pol, vis in unique.items()}
    data: Visibilities = {pol: np.where(redundant.flipped, vis.conj(), vis) for pol, vis in crosses.items()}
    autos = {pol: vis[:, :, -1].real for pol, vis in unique.items() if pol[0] == pol[1]}
    variance = radiometer_variance(autos, observation, settings.nsamples) if autos else {}
    injection = _injection(job, observation, redundant, sky, beams) if settings.effects else None
    truths: list[InjectedTruth] = []
    if injection:
        data, truths = injection.before_noise(data)
    if settings.noise:
        own = job.data.polarization[0]
        data = {pol: add_noise(vis, variance[pol], job.seed, *[pol] * (pol != own)) for pol, vis in data.items()}
    if injection:
        data, more = injection.after_noise(data, variance)
        truths += more
    _check_simulated(observation, data, autos, truths)
    _write_data(folder / "data.uvh5", observation, data, autos, settings.nsamples)
    for pol in job.data.polarization:
        maps = np.array([evaluate_on_grid(beam) for beam in beams[pol]])
        names = [beam.info.name for beam in beams[pol]]
        where = sky.ra, sky.dec, sky.flux
        truth = Truth(observation.freqs, GRID_ZA, GRID_AZ, maps, *where, names, pol, truths)
        write_truth(folder / ("truth.h5" if len(job.data.polarization) == 1 else f"truth-{pol}.h5"), truth)


def _check_simulated(
    observation: Observation, data: Visibilities, autos: Mapping[str, FloatArray], truths: Sequence[InjectedTruth]
) -> None:
    """Make sure that what is written are numbers, and such as are read again."""
    for f, freq in enumerate(observation.freqs):
        where = f"channel {f} ({freq / 1e6:.10g} MHz)"
        for pol, vis in (*data.items(), *autos.items()):
            check_finite(where, {f"simulated {pol}": vis[f]}, SIMULATION)
            if (reached := np.abs(vis[f]).max()) > LARGEST:
                message = f"simulated {pol}: reaches {reached:.3g} Jy, more than is read of any file"
                raise InputError(message, field=where, remedy=SIMULATION)
    check_finite("truth.h5", {"effects": [truth["values"] for truth in truths]}, SIMULATION)


def _write_data(
    path: Path, observation: Observation, data: Visibilities, autos: Mapping[str, FloatArray], nsamples: float
) -> None:
    """Write visibilities, and the autocorrelations that all antennas have alike."""
    values = np.stack([data[pol] for pol in observation.pols], axis=-1)
    shared = None
    if autos:
        of_feeds = np.stack([autos[2 * feed] for feed in feeds_of(observation.pols)], axis=-1)
        shared = np.repeat(of_feeds[:, :, np.newaxis], observation.Nants, axis=2)
    write_uvh5(path, observation, values, np.zeros(values.shape, bool), np.full(values.shape, nsamples), shared)


def _injection(
    job: Job,
    observation: Observation,
    redundant: RedundantGroups,
    sky: Sky,
    beams: Mapping[str, tuple[Beam, ...]],
) -> Injection:
    """Prepare the effects that the job wants in its data."""
    basis, fits = fit_model_beams(job, load_beams(job, observation.freqs, job.data.pol))
    return Injection(job, observation, redundant, sky, beams, basis, [fit.coeffs for fit in fits])
