"""Measured by real ranks: what is read on one of them comes to the others, and no more than they ask for."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvdata import read_observation, read_visibilities
from hydrabeam_mpi.io.uvsource import Data, UVFile, UVInMemory, files_among
from hydrabeam_mpi.setup.held import hold
from tests.visibilities import make_uvdata


def written(comm: MPI.Comm, folder: Path, kind: str) -> Path:
    """Write a small file on rank 0."""
    path = folder / f"data.{kind}"
    if comm.rank == 0:
        uv = make_uvdata()
        uv.phase(lon=1.0, lat=-0.5, cat_name="centre")
        getattr(uv, f"write_{kind}")(str(path), run_check=False)
    comm.Barrier()
    return path


@pytest.mark.parametrize("kind", [pytest.param("miriad", marks=pytest.mark.mpi), "ms"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_rank_gets_what_the_file_has(kind: str, comm: MPI.Comm, common_tmp_path: Path) -> None:
    """To the last bit, rows and channels in any order, and also where the file has gone meanwhile."""
    if kind == "ms":
        pytest.importorskip("casacore")
    path = written(comm, common_tmp_path, kind)
    observation = read_observation([path], Selection(channels=(1, 3)))
    tile = Tile(np.array([4, 1]), np.array([5, 0, 2]) if comm.rank else np.array([3]))
    expected = read_visibilities([path], observation, tile)
    held = hold(comm, (path,))
    assert files_among(held) == [path]
    assert str(held[0]) == str(path)
    comm.Barrier()
    if comm.rank == 0:
        path.rename(path.with_suffix(".gone"))
    comm.Barrier()
    for files in (held, pickle.loads(pickle.dumps(held))) if comm.size > 1 else (held,):
        for got, wanted in zip(read_visibilities(files, observation, tile), expected, strict=True):
            np.testing.assert_array_equal(got, wanted)
    assert read_observation(held, Selection()).Nfreqs == 4
    comm.Barrier()


def test_metadata_are_read_once_where_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept serves when the file has gone, and stays behind where it is sent on."""
    path = written(MPI.COMM_SELF, tmp_path, "uvh5")
    (kept,) = hold(MPI.COMM_SELF, (path,))
    monkeypatch.setattr("hydrabeam_mpi.setup.held.KEPT_BYTES", 40)
    (read_anew,) = hold(MPI.COMM_SELF, (path,))
    assert isinstance(kept, UVFile)
    assert isinstance(read_anew, UVFile)
    first = kept.metadata()
    read_anew.metadata()
    path.unlink()
    assert kept.metadata() is first
    assert kept.may_hold(np.zeros(1), np.zeros(1))
    for other in (read_anew, pickle.loads(pickle.dumps(kept))):
        with pytest.raises(InputError, match="no such file"):
            other.metadata()


@pytest.mark.mpi
def test_other_ranks_keep_no_more_than_their_share(comm: MPI.Comm) -> None:
    if comm.size == 1:
        pytest.skip("one rank holds all")
    n_times, n_freqs = 40, 2000
    uv = None
    if comm.rank == 0:
        made = make_uvdata(times=2459866.2 + 1e-4 * np.arange(n_times), freqs=120e6 + 1e4 * np.arange(n_freqs))
        uv = UVInMemory.of(made, "made")
    files: tuple[Data, ...] = hold(comm, (uv,) if uv else ())
    all_bytes = comm.bcast(uv.data.nbytes if uv else None)
    observation = comm.bcast(read_observation(files, Selection(pols=("ee",))) if comm.rank == 0 else None)
    before = resident()
    share = read_visibilities(files, observation, Tile(np.arange(comm.rank, n_times, 40), np.arange(3)))
    comm.Barrier()
    assert share[0].shape == (n_freqs, 1, 3, 1) or comm.rank >= 40
    if comm.rank:
        assert resident() - before < 0.1 * all_bytes
    comm.Barrier()


def resident() -> int:
    """Return the bytes of memory that this rank has now."""
    return os.sysconf("SC_PAGE_SIZE") * int(Path("/proc/self/statm").read_text().split()[1])


def test_a_damaged_file_is_told_on_all_ranks(comm: MPI.Comm, common_tmp_path: Path) -> None:
    path = common_tmp_path / "data.miriad"
    if comm.rank == 0:
        path.mkdir()
        (path / "vartable").write_bytes(b"nothing")
    comm.Barrier()
    with pytest.raises(InputError, match="cannot be read as miriad"):
        hold(comm, (path,))


def test_files_that_are_read_in_part_stay_files(tmp_path: Path) -> None:
    path = tmp_path / "a.uvh5"
    make_uvdata().write_uvh5(str(path), run_check=False)
    (held,) = hold(MPI.COMM_SELF, (path,))
    assert isinstance(held, UVFile)
    assert held.file == path
