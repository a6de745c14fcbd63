from __future__ import annotations

import pytest
from mpi4py import MPI

from hydrabeam_mpi.mpi import library_version


@pytest.mark.mpi
def test_library_version_is_one_printable_line(comm: MPI.Comm) -> None:
    version = library_version()
    assert version.isprintable()
    assert version in MPI.Get_library_version()
    assert comm.allgather(version) == [version] * comm.size
