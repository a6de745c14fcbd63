from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from hydrabeam_mpi.io.stored import FOLDER, Stored, drop_stored, store


def test_is_taken_for_the_array_itself(tmp_path: Path) -> None:
    array = np.random.default_rng(1).normal(size=(5, 5))
    arrays: dict[str, object] = {"covariance": array}
    store(tmp_path, arrays, "covariance", 3)
    stored = arrays["covariance"]
    assert isinstance(stored, Stored)
    assert (stored.shape, stored.dtype) == (array.shape, array.dtype)
    np.testing.assert_array_equal(np.asarray(stored), array)
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file["covariance"] = stored
        np.testing.assert_array_equal(file["covariance"][()], array)
    drop_stored(tmp_path)
    assert not (tmp_path / FOLDER).exists()


def test_stays_in_memory_where_it_cannot_be_stored(tmp_path: Path) -> None:
    (tmp_path / FOLDER).write_text("in the way")
    for folder in (None, tmp_path):
        array = np.ones(2)
        arrays: dict[str, object] = {"covariance": array}
        store(folder, arrays, "covariance", 0)
        assert arrays["covariance"] is array
