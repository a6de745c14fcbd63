from __future__ import annotations

import json
from collections.abc import Callable
from subprocess import CompletedProcess

# A process of its own, as the peak of this one may lie far above what it needs now.
MEASURE = """
import json
import numpy as np
from mpi4py.MPI import COMM_WORLD as world
from hydrabeam_mpi.mpi import peak_rss_mb

before = peak_rss_mb(world)
if world.rank == world.size - 1:
    np.ones(25_000_000)  # 200 MB, gone at once
after = peak_rss_mb(world)
everyone = world.gather((before, after))
if world.rank == 0:
    print(json.dumps(everyone))
"""


SHARES = """
import json
import os
import resource
import sys
from mpi4py.MPI import COMM_WORLD as world
from hydrabeam_mpi.mpi import memory_per_rank

everyone = world.gather(memory_per_rank(world))
if world.rank == world.size - 1:
    resource.setrlimit(resource.RLIMIT_AS, (3 * 10**9, resource.RLIM_INFINITY))
limited = world.gather(memory_per_rank(world))
if world.rank == 0:
    print(json.dumps([everyone, limited, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]))
"""


def test_ranks_share_a_machine_and_the_least_share_counts(
    mpiexec_python: Callable[..., CompletedProcess[str]],
) -> None:
    shares = {}
    for n in (1, 2):
        result = mpiexec_python(n, SHARES)
        assert result.returncode == 0, result.stderr
        shares[n], limited, machine = json.loads(result.stdout)
        assert len(set(shares[n])) == 1
        assert limited == [min(3 * 10**9, shares[n][0])] * n
    assert shares[2][0] == shares[1][0] // 2
    assert 10**8 < shares[1][0] <= machine


def test_the_largest_rank_counts_and_a_peak_stays(mpiexec_python: Callable[..., CompletedProcess[str]]) -> None:
    result = mpiexec_python(2, MEASURE)
    assert result.returncode == 0, result.stderr
    (before, after), other = json.loads(result.stdout)
    assert other == [before, after]
    assert before + 180 < after < before + 250
