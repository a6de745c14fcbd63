"""What other packages raise becomes one line, in words that speak of the file."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy.io.fits import VerifyError

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import check_file, mute, reading

PATH = Path("/data/a.file")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (VerifyError("Unparsable card (CDELT4), fix it first with .verify('fix')."), "(Unparsable card (CDELT4))"),
        (KeyError("ANTENNAS"), "(it lacks ANTENNAS)"),
        (KeyError("\"Unable to synchronously open object (object 'Data' doesn't exist)\""), "object 'Data' doesn't"),
        (RuntimeError("Unable to synchronously check link existence (bad heap free list)"), "(bad heap free list)"),
        (TypeError("'NoneType' object is not subscriptable"), "(its parts do not fit together)"),
        (MemoryError("std::bad_alloc"), "(it asks for more memory than there is)"),
        (PermissionError(13, "Permission denied", "/data/a.file"), "(Permission denied)"),
        (ValueError("UVParameter _freq_array has unacceptable values."), "(freq_array has unacceptable values)"),
        (ValueError(f"/data/a.file: {'very ' * 100}long"), "(a.file: very very"),
    ],
)
def test_all_that_a_reader_raises_is_one_line(error, words):
    with pytest.raises(InputError) as caught, reading(PATH, "uvh5", field="[data] files", remedy="mend it"):
        raise error
    line = str(caught.value)
    assert line.startswith("/data/a.file: [data] files: cannot be read as uvh5 (")
    assert line.endswith("; mend it")
    assert words in line
    assert "\n" not in line
    assert len(line) < 260


def test_what_is_told_already_only_gets_the_file():
    with pytest.raises(InputError, match=r"^/data/a.file: freqs: is missing; add it$"), reading(PATH, "a table"):
        raise InputError("is missing", field="freqs", remedy="add it")


def test_sizes_in_a_header_beyond_the_memory_are_told(tmp_path):
    """A data set of 80 TB of which nothing is stored; the limit holds within the block alone."""
    path, before = tmp_path / "a.h5", resource.getrlimit(resource.RLIMIT_DATA)
    with h5py.File(path, "w") as file:
        file.create_dataset("a", shape=(10**13,), dtype=float, chunks=(1000,))
    with pytest.raises(InputError, match="more memory than there is"), reading(path, "HDF5"), h5py.File(path) as file:
        np.asarray(file["a"])
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_what_is_no_file_is_told(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    cases = {
        "none": "no such file",
        ".": "a folder, not a file",
        "pipe": "not an ordinary file",
        "a\0": "not a file name",
    }
    for name, words in {**cases, "loop": "cannot be read"}.items():
        with pytest.raises(InputError, match=rf"\[sky\] file: {words}.*; check the path"):
            check_file(tmp_path / name, field="[sky] file")


def test_what_libraries_print_is_silenced(capfd):
    with mute():
        os.write(1, b"said\n")
        os.write(2, b"shouted\n")
    os.write(1, b"heard\n")
    assert capfd.readouterr() == ("heard\n", "")
