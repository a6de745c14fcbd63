"""What is compiled once is there for the next process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.launched import environment

USE = """
from pyuvdata.utils import antnums_to_baseline, bls_numba
import hydrabeam_mpi.io.uvfile
baseline = antnums_to_baseline([1, 2], [3, 4], Nants_telescope=10)
print(baseline.tolist(), sum(bls_numba._antnums_to_baseline.stats.cache_hits.values()))
"""


def run(**changes: str) -> str:
    """Return what another process makes of two baselines, and how often it found compiled what it needed."""
    command = [sys.executable, "-c", USE]
    return subprocess.run(command, env=environment(**changes), check=True, capture_output=True, text=True).stdout


def test_the_next_process_finds_what_one_has_compiled(tmp_path: Path) -> None:
    kept = {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = run(**kept), run(**kept)
    assert first.split() == ["[67587,", "69636]", "0"]
    assert second.split() == ["[67587,", "69636]", "1"]
