"""Mock data as in HDBI II, section 3, from any array, sky and beam."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
from astropy import units
from astropy.coordinates import EarthLocation
from astropy.time import Time

from hydrabeam_mpi.beams import fit_model_beams, load_beams, perturb
from hydrabeam_mpi.config import Job, Simulate
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, Observation
from hydrabeam_mpi.data.partition import make_tiles
from hydrabeam_mpi.data.redundancy import RedundantGroups, find_redundant_groups
from hydrabeam_mpi.diagnose import GRID_AZ, GRID_ZA, evaluate_on_grid
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inject import Injection, Truth
from hydrabeam_mpi.io.staging import writing
from hydrabeam_mpi.io.uvwrite import write_uvh5
from hydrabeam_mpi.model.arrays import hexagon, read_layout
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.model.engine import make_engine
from hydrabeam_mpi.model.rime import ForwardModel
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.mpi import Comm, bcast_object, together
from hydrabeam_mpi.progress import say
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.skies import count_sources, load_sky, source_positions

SIDEREAL_DAY = 0.99726956632908  # days of UT1


def simulate_to(world: Comm, job: Job, folder: Path) -> tuple[Beam, ...]:
    """Write ``data.uvh5`` and ``truth.h5`` into ``folder`` and return the true beams, one a channel.

    Collective: all ranks of `world`, which share out the times.

    Raises
    ------
    InputError
        On all ranks, if the job cannot be simulated.
    """
    assert job.data.simulate is not None
    scene = None
    with together(world):
        if world.rank == 0:
            say("simulating")
            scene = _set_scene(job, job.data.simulate)
    observation, sky, beams = bcast_object(world, scene)
    with together(world):
        redundant = find_redundant_groups(
            observation.bl_vectors, job.data.redundancy_tol, either_sign=_is_copol(observation)
        )
        vectors = np.concatenate([redundant.vectors, np.zeros((1, 3))])
        engine = make_engine(job.solver.engine, vectors)
        model = ForwardModel(source_positions(job, sky, observation), sky.flux, observation.freqs, engine)
        alone = np.zeros(1, dtype=int)
        costs = count_sources(sky, observation)
        tiles = make_tiles(np.arange(observation.Ntimes), costs, alone, alone, world.size)
        part = model.visibilities(beams, tiles[world.rank].times)
    parts = world.gather(part)
    with together(world):
        if parts is not None:
            unique = np.concatenate(parts, axis=1)
            crosses = unique[:, :, redundant.group]
            crosses = np.where(redundant.flipped, crosses.conj(), crosses)
            with writing(folder):
                _write(folder, job, observation, redundant, sky, beams, crosses, unique[:, :, -1].real)
    return beams


def _is_copol(observation: Observation) -> bool:
    """Whether the one polarisation is of equal feeds."""
    return observation.pols[0][0] == observation.pols[0][1]


def _set_scene(job: Job, settings: Simulate) -> tuple[Observation, Sky, tuple[Beam, ...]]:
    """Lay out what is observed, with which sky and which beams."""
    observation = mock_observation(settings, job.data.polarization)
    if not _is_copol(observation) and settings.noise:
        raise InputError(
            f"'{observation.pols[0]}' has no autocorrelations from which to draw noise",
            field="[data] polarization",
            remedy="simulate 'ee' or 'nn', or set noise = false in [data.simulate]",
        )
    beams = load_beams(job, observation.freqs, observation.pols[0])
    if settings.perturb is not None:
        beams = tuple(perturb(job, beam, settings.perturb) for beam in beams)
    return observation, load_sky(job, observation.freqs), beams


def mock_observation(settings: Simulate, pol: str) -> Observation:
    """Lay out array, channels and times: evenly spaced in sidereal time from the first LST, the last excluded."""
    array = settings.array
    layout = read_layout(array.file) if array.file else hexagon(*array.hex, array.spacing)
    location = EarthLocation.from_geodetic(
        settings.longitude * units.deg, settings.latitude * units.deg, settings.height * units.m
    )
    first, last = settings.lst_range
    span = (last - first) % 24 or 24.0
    wait = (first - _lst_hours(settings.start, location)) % 24
    hours = wait + span * np.arange(settings.n_times) / settings.n_times
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
        integration_time=np.full(settings.n_times, settings.integration_time),
        pols=(pol,),
    )


def _lst_hours(times: FloatArray | float, location: EarthLocation) -> FloatArray:
    """Local apparent sidereal time in hours."""
    return np.asarray(Time(times, format="jd", location=location).sidereal_time("apparent").hour)


def radiometer_variance(autos: FloatArray, observation: Observation, nsamples: float) -> FloatArray:
    """sigma^2 = V_jj V_kk / (dt dnu) of identical antennas (HDBI II, eq. 22), (Nfreqs, Ntimes)."""
    samples = nsamples * observation.channel_width[:, np.newaxis] * observation.integration_time
    return autos**2 / samples


def add_noise(data: ComplexArray, variance: FloatArray, seed: int) -> ComplexArray:
    """Add circular Gaussian noise, drawn by channel and time so that no rank count changes it."""
    noisy = data.copy()
    for f, t in np.ndindex(variance.shape):
        noise = complex_normal(generator(seed, "noise", f, t), (data.shape[2],))
        noisy[f, t] += noise * np.sqrt(variance[f, t])
    return noisy


def _write(
    folder: Path,
    job: Job,
    observation: Observation,
    redundant: RedundantGroups,
    sky: Sky,
    beams: tuple[Beam, ...],
    crosses: ComplexArray,
    autos: FloatArray,
) -> None:
    """Add noise and write the data and the truth."""
    settings = job.data.simulate
    assert settings is not None
    variance = radiometer_variance(autos, observation, settings.nsamples)
    injection = _injection(job, observation, redundant, sky, beams) if settings.effects else None
    truths: list[Truth] = []
    if injection:
        crosses, truths = injection.before_noise(crosses)
    if settings.noise:
        crosses = add_noise(crosses, variance, job.seed)
    if injection:
        crosses, more = injection.after_noise(crosses, variance)
        truths += more
    data = crosses[..., np.newaxis]
    nsamples = np.full(data.shape, settings.nsamples)
    shared = np.repeat(autos[..., np.newaxis], observation.Nants, axis=2)[..., np.newaxis]
    flags = np.zeros(data.shape, dtype=bool)
    write_uvh5(folder / "data.uvh5", observation, data, flags, nsamples, shared if _is_copol(observation) else None)
    with h5py.File(folder / "truth.h5", "w") as file:
        file["freqs"], file["grid_za"], file["grid_az"] = observation.freqs, GRID_ZA, GRID_AZ
        file["beam"] = np.array([evaluate_on_grid(beam) for beam in beams])
        file["ra"], file["dec"], file["flux"] = sky.ra, sky.dec, sky.flux
        file.attrs["beam_names"] = [beam.info.name for beam in beams]
        file.attrs["polarization"] = observation.pols[0]
        file.attrs["effects"] = json.dumps(truths)


def _injection(
    job: Job, observation: Observation, redundant: RedundantGroups, sky: Sky, beams: tuple[Beam, ...]
) -> Injection:
    """Prepare the effects that the job wants in its data."""
    basis, fits = fit_model_beams(job, load_beams(job, observation.freqs, observation.pols[0]))
    return Injection(job, observation, redundant, sky, beams, basis, [fit.coeffs for fit in fits])
