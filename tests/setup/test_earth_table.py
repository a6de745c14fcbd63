"""The table of the Earth's orientation comes from rank 0."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.time import Time
from astropy.utils import iers
from mpi4py import MPI

from hydrabeam_mpi.setup.earth_table import share_earth_table

TIMES = Time(2459866.0 + np.arange(3), format="jd")


@pytest.mark.mpi
def test_other_ranks_do_not_read_it(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = TIMES.get_delta_ut1_utc(iers.IERS_Auto.read())

    def refuse() -> None:
        raise AssertionError("read on another rank")

    monkeypatch.setattr(iers.IERS_Auto, "iers_table", None)
    if comm.rank:
        monkeypatch.setattr(iers.IERS_Auto, "read", refuse)
    share_earth_table(comm)
    np.testing.assert_array_equal(TIMES.get_delta_ut1_utc(), expected)
