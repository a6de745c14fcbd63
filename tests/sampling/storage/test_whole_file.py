"""The checksum that an image of a file gets is the one that HDF5 itself writes."""

from __future__ import annotations

import io

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.sampling.storage.whole_file import LIBRARIES, SUPERBLOCK, with_checksum


@pytest.mark.parametrize("length", [1, 100, 10_000])
def test_the_checksum_is_that_of_hdf5(length: int) -> None:
    stream = io.BytesIO()
    with h5py.File(stream, "w", libver=LIBRARIES) as file:
        file["x"] = np.arange(length)
    right = stream.getvalue()
    wrong = right[:SUPERBLOCK] + bytes(4) + right[SUPERBLOCK + 4 :]
    with pytest.raises(OSError, match="checksum"):
        h5py.File(io.BytesIO(wrong), "r")
    assert with_checksum(wrong) == right
