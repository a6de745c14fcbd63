"""What reading and writing cost on this machine: visibilities of noise, written to a temporary file and read again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.fit.rows import read_rows
from hydrabeam_mpi.io.uvwrite import write_uvh5
from hydrabeam_mpi.loop.checks.health import check_health
from hydrabeam_mpi.mpi import ProcessGrid, alone
from hydrabeam_mpi.planning.outline import Clock, Outline
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.simulation.arrays import hexagon

SIDES = (3, 5), (6, 11)
"""Two hexagons: of 19 antennas, 171 baselines, and of 91 antennas, 4095 baselines."""
TIMES = 12
"""With which the larger file has 49,000 visibilities, 1 MB: the time of each is told from that of opening a file."""


@dataclass(frozen=True)
class Files:
    """Seconds for a file, and for each of its visibilities.

    The first file that a process writes takes ``first_s`` more, in which libraries are loaded and compiled.
    """

    first_s: float
    write: tuple[float, float]
    read: tuple[float, float]
    health: tuple[float, float]


def measure_files(outline: Outline, clock: Clock) -> Files:
    """Write and read two files of different size. Serial."""
    sizes, seconds = [], []
    _, first, *_ = _of_array(outline, SIDES[0], clock)
    for sides in SIDES:
        n, *taken = _of_array(outline, sides, clock)
        sizes.append(n)
        seconds.append(taken)
    found = []
    for few, many in zip(*seconds, strict=True):
        each = max(many - few, 0.0) / (sizes[1] - sizes[0])
        found.append((max(few - each * sizes[0], 0.0), each))
    return Files(max(first - seconds[0][0], 0.0), *found)


def _of_array(outline: Outline, sides: tuple[int, int], clock: Clock) -> tuple[int, float, float, float]:
    """Return the number of visibilities, and the seconds in which they are written, read and looked at."""
    layout = hexagon(*sides, 14.6)
    one, two = np.triu_indices(len(layout.numbers), 1)
    at = outline.problem.observation
    index = np.resize(np.arange(at.Ntimes), TIMES)
    observation: Observation = replace(
        at,
        antenna_numbers=layout.numbers,
        antenna_names=layout.names,
        antpos=layout.antpos,
        antpairs=np.stack([layout.numbers[one], layout.numbers[two]], axis=1),
        times=at.times[0] + np.arange(TIMES) / 1440,
        lsts=at.lsts[index],
        integration_time=at.integration_time[index],
        exclude_times=(),
        exclude_baselines=(),
    )
    shape = (1, TIMES, observation.Nbls, 1)
    data = complex_normal(generator(0, "plan"), shape)
    flags = np.zeros(shape, bool)
    autos = np.full((1, TIMES, observation.Nants, 1), 1e3) if observation.is_copolar else None
    problem = replace(
        outline.problem,
        job=outline.job.model_copy(update={"noise": outline.job.noise.model_copy(update={"kind": "autocorrelations"})}),
        observation=observation,
        redundant=find_redundant_groups(observation.bl_vectors, 1e-3, observation.is_copolar),
        train=Tile(np.arange(0, TIMES, 2), np.arange(observation.Nbls)),
        test=Tile(np.arange(1, TIMES, 2), np.arange(observation.Nbls)),
        sky=outline.problem.sky.select(np.arange(1)),
        gain_files=(),
        noise_file=None,
        noise_variance=None,
    )
    with TemporaryDirectory(prefix="hydrabeam-") as folder:
        path = Path(folder) / "data.uvh5"
        start = clock()
        write_uvh5(path, observation, data, flags, np.ones(shape), autos)
        written = clock()
        problem = replace(problem, files=(path,))
        for tile in (problem.train, problem.test):
            read_rows(problem, tile)
        read = clock()
        check_health(ProcessGrid.split(alone(), 1), problem)
        done = clock()
    return data.size, written - start, read - written, done - read
