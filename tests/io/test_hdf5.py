from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.io.hdf5 import new_hdf5

SOURCE = """
import sys
from pathlib import Path
import numpy as np
from hydrabeam_mpi.io.hdf5 import new_hdf5
try:
    with new_hdf5(Path(sys.argv[1]) / "a.h5") as file:
        for i in range(int(sys.argv[2])):
            file.create_group(f"g{i}").attrs["text"] = "x" * 100
            file[f"g{i}/a"] = np.arange(float(sys.argv[3]))
except OSError as error:
    print(error)
"""


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(b"x" * 100_000)
    with new_hdf5(path) as file:
        file["a"] = np.arange(5)
        file.attrs["text"] = "ä"
    assert path.stat().st_size < 10_000
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["a"], np.arange(5))
        assert file.attrs["text"] == "ä"


def test_what_goes_wrong_in_the_block_is_told(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), new_hdf5(tmp_path / "a.h5"):
        1 / 0  # noqa: B018


# Many small pieces, also more than HDF5 keeps in memory; some larger ones; a large one.
@pytest.mark.parametrize(("pieces", "length"), [(1000, 10), (20000, 1), (100, 1000), (1, 1_000_000)])
def test_a_full_disk_says_so_once_and_python_ends_well(pieces: int, length: int, small_disk: Path) -> None:
    words = [sys.executable, "-c", SOURCE, small_disk, str(pieces), str(length)]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ended.stdout == "[Errno 28] No space left on device\n"
    assert ended.stderr == ""
    assert ended.returncode == 0
