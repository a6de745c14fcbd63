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

OWN = """
import numpy as np
from hydrabeam_mpi.model.bases.polar_table import PolarTable, _interpolate, radii
table = PolarTable(np.ones((len(radii(40)), 40)), 40)
print(table(np.array([0.3]), np.array([1.0])).round(12)[0], *_interpolate._machine_code.stats.cache_hits.values())
"""


def run(script: str, **changes: str) -> str:
    """Return what another process prints: what it found, and how often it found compiled what it needed."""
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=environment(**changes), check=True, capture_output=True, text=True).stdout


def test_the_next_process_finds_what_one_has_compiled(tmp_path: Path) -> None:
    kept = {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = run(USE, **kept), run(USE, **kept)
    assert first.split() == ["[67587,", "69636]", "0"]
    assert second.split() == ["[67587,", "69636]", "1"]


def test_so_does_what_needs_a_function_of_our_own(tmp_path: Path) -> None:
    kept = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert run(OWN, **kept).split() == ["1.0"]
    assert run(OWN, **kept).split() == ["1.0", "1"]


def test_what_is_needed_works_where_nothing_can_be_kept(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "file")}
    assert run(USE, **kept).split()[:2] == ["[67587,", "69636]"]
    assert run(OWN, **kept).split()[0] == "1.0"
