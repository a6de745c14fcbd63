"""Files that appear whole, and that tell whether they have been damaged since.

Each ends with the SHA-256 of all that stands before it, which readers of HDF5 pass over.
"""

from __future__ import annotations

import hashlib
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

SUPERBLOCK = 44
"""Bytes at the beginning of such a file, which their checksum follows."""
WORD = (1 << 32) - 1


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
    with h5py.File(path.name, "w", driver="core", backing_store=False, libver=LIBRARIES, **order) as file:
        fill(file)
        file.flush()
        image = with_checksum(file.id.get_file_image())
    write_whole(path, image, checked=True)


def with_checksum(image: bytes) -> bytes:
    """Renew the checksum of the beginning of a file.

    HDF5 before 2.0 takes the mark of a file that is open for writing out of an image, but leaves the checksum with it.
    """
    return image[:SUPERBLOCK] + _lookup3(image[:SUPERBLOCK]).to_bytes(4, "little") + image[SUPERBLOCK + 4 :]


def _lookup3(key: bytes) -> int:
    """Compute the checksum of HDF5's metadata, the function ``hashlittle`` of Bob Jenkins' lookup3.c.

    For whole words of four bytes.
    """
    words = [int.from_bytes(key[i : i + 4], "little") for i in range(0, len(key), 4)]
    x = y = z = (0xDEADBEEF + len(key)) & WORD
    while len(words) > 3:
        x, y, z = (x + words[0]) & WORD, (y + words[1]) & WORD, (z + words[2]) & WORD
        words = words[3:]
        for shift in (4, 6, 8, 16, 19, 4):
            x, y, z = y, (z + y) & WORD, (x - z & WORD) ^ _turned(z, shift)
    words += [0] * (3 - len(words))
    x, y, z = (z + words[2]) & WORD, (x + words[0]) & WORD, (y + words[1]) & WORD
    for shift in (14, 11, 25, 16, 4, 14, 24):
        x, y, z = y, z, (x ^ z) - _turned(z, shift) & WORD
    return z


def _turned(word: int, shift: int) -> int:
    return (word << shift | word >> 32 - shift) & WORD


def write_whole(path: Path, content: bytes, *, checked: bool = False) -> None:
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
