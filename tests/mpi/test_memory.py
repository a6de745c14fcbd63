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


def test_the_largest_rank_counts_and_a_peak_stays(mpiexec_python: Callable[..., CompletedProcess[str]]) -> None:
    result = mpiexec_python(2, MEASURE)
    assert result.returncode == 0, result.stderr
    (before, after), other = json.loads(result.stdout)
    assert other == [before, after]
    assert before + 180 < after < before + 250
