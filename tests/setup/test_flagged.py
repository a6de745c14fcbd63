"""Channels of which all data are flagged, of files that pyuvdata wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.setup.flagged import FIRST_ROWS, without_flagged
from hydrabeam_mpi.setup.selected import observe
from tests.visibilities import SECOND, make_uvdata

N_TIMES = 40


@pytest.fixture
def path(common_tmp_path: Path, comm: MPI.Comm) -> Path:
    """A file of six channels: 0, 2 and 3 are flagged, and 5 but for one sample among the last."""
    if comm.rank == 0:
        uv = make_uvdata(times=2459866.2 + 10 * SECOND * np.arange(N_TIMES), freqs=120e6 + 1e6 * np.arange(6))
        uv.flag_array[:, [0, 2, 3]] = True
        uv.flag_array[:, 5] = True
        last = np.flatnonzero((uv.ant_1_array != uv.ant_2_array) & (uv.time_array == uv.time_array.max()))[-1]
        uv.flag_array[last, 5] = False
        assert last > FIRST_ROWS
        uv.write_uvh5(str(common_tmp_path / "data.uvh5"), run_check=False)
    comm.Barrier()
    return common_tmp_path / "data.uvh5"


def job_of(path: Path, **data: object) -> Job:
    return Job.model_validate({"data": {"files": (str(path),), **data}})


@pytest.mark.mpi
def test_they_are_left_out_and_told(path: Path, comm: MPI.Comm) -> None:
    job = job_of(path, flux_scale=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    narrowed, kept = without_flagged(comm, job, (path,), observe(job, (path,)))
    np.testing.assert_array_equal(kept.freqs, [121e6, 124e6, 125e6])
    assert kept.doubts == ("Skipped 3 of 6 channels, of which all data are flagged: 120, 122 to 123 MHz.",)
    assert narrowed.data.flux_scale == (2.0, 5.0, 6.0)
    np.testing.assert_array_equal(observe(narrowed, (path,)).freqs, kept.freqs)


def test_samples_that_the_job_excludes_do_not_count(path: Path, comm: MPI.Comm) -> None:
    end = 2459866.2 + 10 * SECOND * (N_TIMES - 1)
    job = job_of(path, channels=(4, 5), exclude_times=((end - SECOND, end + SECOND),))
    _, kept = without_flagged(comm, job, (path,), observe(job, (path,)))
    np.testing.assert_array_equal(kept.freqs, [124e6])


def test_where_all_count_the_job_stays(path: Path, comm: MPI.Comm) -> None:
    job = job_of(path, channels=(1, 4))
    observation = observe(job, (path,))
    narrowed, kept = without_flagged(comm, job, (path,), observation)
    assert narrowed is job
    assert kept is observation


def test_nothing_but_flags_is_refused(path: Path, comm: MPI.Comm) -> None:
    job = job_of(path, channels=(0, 2))
    with pytest.raises(InputError, match="flag_array: all selected data are flagged"):
        without_flagged(comm, job, (path,), observe(job, (path,)))
