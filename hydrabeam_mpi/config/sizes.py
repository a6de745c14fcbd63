"""Sizes that a job asks for, against the memory that there is."""

from __future__ import annotations

from collections.abc import Iterator

from hydrabeam_mpi.config.job import Job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.words import size

REAL, COMPLEX = 8, 16
PER_SOURCE = 3 * REAL
"""Bytes of a source's right ascension, declination and reference flux."""
PER_MODE = 250
"""Bytes of a mode of the whole basis as Python keeps it: its numbers, its rows, its product. Measured."""
PER_BASELINE = 12 * REAL
"""Bytes of a pair of antennas, and of its vector in either direction, in a list and in a tree."""
PER_VISIBILITY = 3 * COMPLEX + REAL + 1
"""Bytes of a simulated visibility: as the array sees it, with noise, and as it is written, with weight and flag."""


def check_sizes(job: Job, memory: int) -> None:
    """Refuse what cannot fit, whatever else a job needs.

    Counted is the least that has to be in the memory of one rank at one time, so that no job is refused that could run.

    Parameters
    ----------
    job : Job
    memory : int
        Bytes that a rank has.

    Raises
    ------
    InputError
        If a size asks for more.
    """
    for field, n_bytes in _needed(job):
        check_fits(field, n_bytes, memory)


def check_fits(field: str, n_bytes: int, memory: int) -> None:
    """Refuse one size.

    Raises
    ------
    InputError
        If ``n_bytes`` are more than ``memory``.
    """
    if n_bytes > memory:
        raise InputError(
            f"takes {size(n_bytes)} of memory in each rank at least, and here a rank has {size(memory)}",
            field=field,
            remedy="ask for less, or use fewer ranks on each machine or machines with more",
        )


def simulated_bytes(n_antennas: int, n_times: int, n_freqs: int) -> int:
    """Return the bytes of an array's visibilities."""
    n_baselines = n_antennas * (n_antennas - 1) // 2
    return n_baselines * (PER_BASELINE + PER_VISIBILITY * n_times * n_freqs)


def _needed(job: Job) -> Iterator[tuple[str, int]]:
    """Yield for every size the keys that make it and the bytes that it takes."""
    simulate, basis = job.data.simulate, job.basis
    n_freqs = len(simulate.freqs) if simulate else 1
    if job.sky.kind == "mock":
        yield f"[sky] n_sources = {job.sky.n_sources}", job.sky.n_sources * (PER_SOURCE + REAL * n_freqs)
    item, n_modes = REAL, (basis.max_degree + 1) * (basis.max_degree + 2) // 2
    field = f"[basis] max_degree = {basis.max_degree}"
    if basis.kind == "fourier-bessel":
        item, n_modes, field = (
            COMPLEX if basis.form == "complex" else REAL,
            basis.n_modes,
            f"[basis] n_modes = {basis.n_modes}",
        )
        yield f"[basis] m_max = {basis.m_max}", PER_MODE * basis.k_max * (2 * basis.m_max + 1)
    # The precision and its factor.
    yield field, 2 * item * n_modes**2
    yield f"[output] draws = {job.output.draws}", 2 * item * n_modes * job.output.draws
    if simulate and simulate.array.file is None:
        n_antennas = _hexagon(*simulate.array.hex)
        yield f"[data.simulate.array] hex = {list(simulate.array.hex)}", simulated_bytes(n_antennas, 1, 1)
        for name, n_times in (("n_times", simulate.n_times), ("nights", simulate.n_times * simulate.nights)):
            told = f"[data.simulate] {name} = {getattr(simulate, name)}"
            yield told, simulated_bytes(n_antennas, n_times, n_freqs)


def _hexagon(side: int, diagonal: int) -> int:
    """Return how many antennas it has: the longest row, and all shorter ones twice."""
    return diagonal + (diagonal - side) * (side + diagonal - 1)
