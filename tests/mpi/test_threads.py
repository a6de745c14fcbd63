from __future__ import annotations

import json
from collections.abc import Callable
from subprocess import CompletedProcess

import pytest

from hydrabeam_mpi.mpi.threads import fair_share

COUNT_THREADS = """
import json, os
from mpi4py.MPI import COMM_WORLD as world
import threadpoolctl
from hydrabeam_mpi.mpi import limit_blas_threads

said = limit_blas_threads(world)
again = limit_blas_threads(world)
blas = [pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
cores = sorted(os.sched_getaffinity(0))
everyone = world.gather((said, again, blas, os.environ["OMP_NUM_THREADS"], cores))
if world.rank == 0:
    print(json.dumps(everyone))
"""

ROOTS_ALONE = """
import json, os
from mpi4py.MPI import COMM_WORLD as world
from hydrabeam_mpi.mpi import ProcessGrid, blas_threads, limit_blas_threads

counts = [limit_blas_threads(world)]
for n_channels in (2, 1):
    with ProcessGrid.split(world, n_channels).roots_alone():
        counts.append(blas_threads())
everyone = world.gather((*counts, blas_threads(), sorted(os.sched_getaffinity(0))))
if world.rank == 0:
    print(json.dumps(everyone))
"""


@pytest.mark.parametrize(
    ("cores_of_ranks", "shares"),
    [
        ([{0, 1, 2, 3}], [4]),
        ([{0, 1, 2, 3}] * 2, [2, 2]),
        ([{0, 1, 2, 3}] * 3, [1, 1, 1]),
        ([{0, 1}] * 5, [1] * 5),  # more ranks than cores
        ([{0, 1}, {2, 3}], [2, 2]),  # bound to cores of their own
        ([{0, 1}, {2, 3, 4}], [2, 3]),
        ([{0, 1, 2}, {2, 3, 4}], [2, 2]),  # partly shared
        ([set(range(49))] * 49, [1] * 49),  # 49 times 1/49 is not 1 in floating point
        ([set(range(98))] * 49, [2] * 49),
    ],
)
def test_fair_share(cores_of_ranks: list[set[int]], shares: list[int]) -> None:
    assert [fair_share(cores_of_ranks, rank) for rank in range(len(cores_of_ranks))] == shares


@pytest.mark.parametrize("n", [1, 2, 3])
def test_ranks_times_threads_fit_the_cores(mpiexec_python: Callable[..., CompletedProcess[str]], n: int) -> None:
    result = mpiexec_python(n, COUNT_THREADS, OMP_NUM_THREADS="")
    assert result.returncode == 0, result.stderr
    everyone = json.loads(result.stdout)
    assert len(everyone) == n
    for said, again, blas, inherited, _ in everyone:
        assert said == again == int(inherited) >= 1
        assert set(blas) == {said}
    # The launcher may bind ranks to some of the machine's cores.
    n_cores = len({core for *_, cores in everyone for core in cores})
    n_threads = sum(said for said, *_ in everyone)
    assert n_threads <= max(n, n_cores)
    assert n_threads > n_cores - n


def test_roots_use_the_cores_of_those_that_wait(mpiexec_python: Callable[..., CompletedProcess[str]]) -> None:
    result = mpiexec_python(2, ROOTS_ALONE, OMP_NUM_THREADS="")
    assert result.returncode == 0, result.stderr
    (before, together, within, after, cores), (*_, idle, left, _) = json.loads(result.stdout)
    assert within == len(cores)
    # Where every rank is the root of a group of its own there is no more to have.
    assert before == together == after == idle == left


def test_roots_use_no_more_where_the_user_says_so(mpiexec_python: Callable[..., CompletedProcess[str]]) -> None:
    result = mpiexec_python(2, ROOTS_ALONE, OMP_NUM_THREADS="1")
    assert result.returncode == 0, result.stderr
    assert all(counts == [1, 1, 1, 1] for *counts, _ in json.loads(result.stdout))


@pytest.mark.parametrize("name", ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"])
def test_what_the_user_set_stays(mpiexec_python: Callable[..., CompletedProcess[str]], name: str) -> None:
    result = mpiexec_python(1, COUNT_THREADS, **{"OMP_NUM_THREADS": "1", name: "1"})
    assert result.returncode == 0, result.stderr
    [(said, again, blas, *_)] = json.loads(result.stdout)
    assert said == again == 1
    assert set(blas) == {1}
