"""Files that appear whole, and that tell whether they have been damaged since.

Each ends with the SHA-256 of all that stands before it, which readers of HDF5 pass over.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable
from pathlib import Path

import h5py

from hydrabeam_mpi.io.disk import replacing

DIGEST = hashlib.sha256().digest_size
BLOCK = 1 << 22
"""Bytes that are read at a time."""
DESCRIPTION = 1 << 14
"""Bytes that HDF5 sets aside at a time for names, attributes and where the data are."""
LIBRARIES = ("v110", "v110")
"""Layout of HDF5 1.10, of 2016, in which growing sets of data are found faster than in the older ones."""


def write_hdf5(path: Path, fill: Callable[[h5py.File], None]) -> None:
    """Write an HDF5 file under a temporary name, with its checksum, and rename it once it is on the disk.

    It is made in memory: HDF5 itself cannot end well on a disk that is full.

    Raises
    ------
    OSError
        If it cannot be written; there is then nothing of it, and what stood in its place stays.
    """
    # Without a cache, and with room for all that describes the data, that comes first and then what is written first.
    order = {"rdcc_nbytes": 0, "meta_block_size": DESCRIPTION}
    # Not an image of HDF5's own: before 2.0 its beginning, still marked as open, has a checksum that does not hold.
    stream = io.BytesIO()
    with h5py.File(stream, "w", libver=LIBRARIES, **order) as file:
        fill(file)
    write_file(path, stream.getvalue(), checked=True)


def write_file(path: Path, content: bytes, *, checked: bool = False) -> None:
    """Write a file under a temporary name, and rename it once it is on the disk; ``checked`` adds the checksum."""
    with replacing(path) as partial, partial.open("wb") as stream:
        stream.write(content)
        if checked:
            stream.write(hashlib.sha256(content).digest())
        stream.flush()
        os.fsync(stream.fileno())
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make sure that the names in a folder are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_whole(path: Path) -> bool:
    """Whether a file that `write_hdf5` wrote is as it was.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        left = os.fstat(stream.fileno()).st_size - DIGEST
        while left > 0 and (block := stream.read(min(left, BLOCK))):
            digest.update(block)
            left -= len(block)
        return left == 0 and stream.read() == digest.digest()
