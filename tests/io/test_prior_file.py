"""The prior from a file, and what is refused in its place."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.prior_file import read_prior
from hydrabeam_mpi.model.bases.zernike import Zernike

BASIS = Zernike(2, np.pi / 2)
N = BASIS.n_modes


def covariance():
    root = np.random.default_rng(3).normal(size=(N, 2 * N))
    return root @ root.T


def changed(index, value):
    matrix = covariance()
    matrix[index] = value
    return matrix


def write(path, mean=None, matrix=None, basis=None):
    with h5py.File(path, "w") as file:
        file["mean"] = np.zeros(N) if mean is None else mean
        file["covariance"] = covariance() if matrix is None else matrix
        file.attrs["basis"] = json.dumps(BASIS.describe()) if basis is None else basis
    return path


def test_a_prior_is_read(tmp_path):
    prior = read_prior(write(tmp_path / "prior.h5", mean=np.arange(N)), BASIS)
    np.testing.assert_array_equal(prior.mean, np.arange(N))
    np.testing.assert_allclose(prior.std() ** 2, np.diag(covariance()))
    single = covariance().astype(np.float32)
    np.testing.assert_allclose(read_prior(write(tmp_path / "prior.h5", matrix=single), BASIS).std(), prior.std(), 1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mean": np.zeros(N + 1)}, rf"mean: has the shape \({N + 1},\), but the basis has {N} modes"),
        ({"mean": np.full(N, np.nan)}, "mean: holds values that are NaN"),
        ({"mean": np.zeros(N, complex)}, "mean: holds values of type complex128, not real numbers"),
        ({"mean": np.array([b"text"] * N)}, r"mean: holds values of type \|S4"),
        ({"matrix": np.eye(N + 1)}, "covariance: has the shape"),
        ({"matrix": changed((0, 0), np.inf)}, "covariance: holds values that are NaN, infinite"),
        ({"matrix": changed((1, 0), 99.0)}, r"covariance: .* elements \((0, 1|1, 0)\)"),
        ({"matrix": changed((2, 2), -1.0)}, "covariance: the variance of mode 2 is -1, not positive"),
        ({"matrix": np.ones((N, N))}, r"\[prior\] file: the prior covariance is not positive definite"),
        ({"basis": '{"kind": "zernike"}'}, "basis: is of another basis"),
        ({"basis": "{"}, r"\[prior\] file: cannot be read as a prior"),
    ],
)
def test_what_is_no_prior_is_refused(tmp_path, change, words):
    with pytest.raises(InputError, match=rf"prior.h5: {words}.*; "):
        read_prior(write(tmp_path / "prior.h5", **change), BASIS)


def test_a_damaged_or_missing_file_is_refused(tmp_path):
    path = write(tmp_path / "prior.h5")
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match=r"\[prior\] file: cannot be read as a prior \(truncated file\)"):
        read_prior(path, BASIS)
    with pytest.raises(InputError, match=r"\[prior\] file: a folder, not a file"):
        read_prior(tmp_path, BASIS)
