"""Visibilities that are not whole, or cannot be read without risk."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import read_metadata
from hydrabeam_mpi.io.uvmeta import read_observation
from tests.visibilities import make_uvdata


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("Data/flags", np.zeros((66, 4, 2)), "Data/flags: holds values of type float64, not true or false"),
        ("Data/visdata", np.zeros((66, 4, 2)), "Data/visdata: holds values of type float64, not complex numbers"),
        ("Header/freq_array", np.array([b"a", b"b", b"c", b"d"]), "cannot be read as uvh5|freq_array: not an array"),
    ],
)
def test_samples_of_another_type_are_refused(tmp_path, field, value, words):
    path = tmp_path / "a.uvh5"
    make_uvdata().write_uvh5(str(path), run_check=False)
    with h5py.File(path, "r+") as file:
        del file[field]
        file[field] = value
    with pytest.raises(InputError, match=rf"a.uvh5: ({words}).*; ") as caught:
        read_metadata(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("kind", "part"), [("miriad", "vartable"), ("ms", "ANTENNA/table.dat")])
def test_a_damaged_folder_does_not_end_the_program(tmp_path, capfd, kind, part):
    """The libraries in C end the process that meets one."""
    uv = make_uvdata(pols=(-5,))
    if kind == "ms":
        pytest.importorskip("casacore")
        uv.write_ms(str(tmp_path / "a.uv"), run_check=False, force_phase=True)
    else:
        uv.write_miriad(str(tmp_path / "a.uv"), run_check=False)
    (tmp_path / "a.uv" / "link").symlink_to("nowhere")
    assert read_observation([tmp_path / "a.uv"], Selection()).Ntimes == 6
    table = tmp_path / "a.uv" / part
    table.write_bytes(table.read_bytes()[:40])
    capfd.readouterr()
    with pytest.raises(InputError, match=rf"a.uv: cannot be read as {kind} \(.+\); "):
        read_observation([tmp_path / "a.uv"], Selection())
    assert capfd.readouterr() == ("", "")
