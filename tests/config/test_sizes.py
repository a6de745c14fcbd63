"""What no memory holds is refused with the key, with what it takes and with what there is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.sizes import check_sizes, simulated_bytes
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.simulation.arrays import hexagon

GB = 10**9
SIMULATE = "[data.simulate]\n"
FILES = "[data]\nfiles = ['a']\n"


def load(text: str, folder: Path) -> Job:
    (folder / "job.toml").write_text(text)
    return load_job(folder / "job.toml")


@pytest.mark.parametrize(
    ("text", "field"),
    [
        (FILES + "[sky]\nn_sources = 1000000000000", "[sky] n_sources = 1000000000000: takes 32 TB of memory"),
        (SIMULATE + "n_times = 9223372036854775807", "[data.simulate] n_times = 9223372036854775807: takes "),
        (SIMULATE + "array = {hex = [4, 200000]}", "[data.simulate.array] hex = [4, 200000]: takes "),
        (SIMULATE + "array = {hex = [9000000000000000000, 9000000000000000000]}", "[data.simulate.array] hex = ["),
        (FILES + "[output]\ndraws = 1000000000000", "[output] draws = 1000000000000: takes "),
        (FILES + "[basis]\nn_modes = 130000\nk_max = 1200\nm_max = 180", "[basis] n_modes = 130000: takes 270 GB"),
        (FILES + "[basis]\nkind = 'zernike'\nmax_degree = 1000000", "[basis] max_degree = 1000000: takes "),
    ],
)
def test_too_large(text: str, field: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        check_sizes(load(text, tmp_path), 64 * GB)
    line = str(raised.value)
    assert line.startswith(field)
    assert line.endswith("in each rank at least, and here a rank has 64 GB; ask for less, or use fewer ranks on each "
                         "machine or machines with more")  # fmt: skip


def test_limits_lie_where_the_memory_ends(tmp_path: Path) -> None:
    job = load(FILES + "[basis]\nn_modes = 4000\n[sky]\nn_sources = 1", tmp_path)
    needed = 2 * 8 * 4000**2
    check_sizes(job, needed)
    with pytest.raises(InputError, match=r"n_modes = 4000"):
        check_sizes(job, needed - 1)


def test_other_kinds_are_not_counted(tmp_path: Path) -> None:
    text = (
        "[sky]\nkind = 'catalogue'\nfile = 'a.skyh5'\n[basis]\nkind = 'zernike'\nmax_degree = 2\n[output]\ndraws = 0\n"
    )
    check_sizes(load(FILES + text, tmp_path), 10_000)


@pytest.mark.parametrize("hexagonal", [(1, 2), (4, 7), (3, 3), (2, 9)])
def test_antennas_are_those_of_the_layout(hexagonal: tuple[int, int], tmp_path: Path) -> None:
    little = "[sky]\nn_sources = 1\n[output]\ndraws = 0\n[basis]\nn_modes = 1\nk_max = 1\nm_max = 0"
    job = load(SIMULATE + f"array = {{hex = {list(hexagonal)}}}\nn_times = 1\n" + little, tmp_path)
    needed = simulated_bytes(len(hexagon(*hexagonal, 1.0).numbers), 1, 1)
    check_sizes(job, max(needed, 250))
    if needed > 250:
        with pytest.raises(InputError, match="hex"):
            check_sizes(job, needed - 1)


def test_what_is_counted_is_less_than_what_a_simulation_takes() -> None:
    """So that nothing is refused that could run."""
    n_ants, n_times, n_freqs = 61, 10, 2
    shape = (n_freqs, n_times, n_ants * (n_ants - 1) // 2)
    written = sum(np.zeros(shape, kind).nbytes for kind in (complex, complex, complex, float, bool))
    assert written < simulated_bytes(n_ants, n_times, n_freqs) < 1.2 * written
