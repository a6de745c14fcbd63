"""The file of a prior: mean and covariance of a basis's coefficients, as ``tools/ensemble_prior`` writes them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.prior import CovariancePrior
from hydrabeam_mpi.io.reading import check_file, reading
from hydrabeam_mpi.model.bases.base import LinearBasis

ROUNDING = float(np.finfo(np.float32).eps)
"""Largest difference of elements (i, j) and (j, i) of a covariance that rounding makes, over sigma_i sigma_j.

Single precision, in which a file may be, and the sums that make a covariance stay well below it.
"""
_REMEDY = "make one with tools/ensemble_prior"


def read_prior(path: Path, basis: LinearBasis) -> CovariancePrior:
    """Read the prior of a basis's coefficients.

    Parameters
    ----------
    path : Path
        HDF5 with ``mean``, (n,), ``covariance``, (n, n), and the attribute ``basis``, the JSON description of the
        basis.
    basis : LinearBasis

    Raises
    ------
    InputError
        If the file is missing or damaged, is of another basis, or its covariance is none.
    """
    check_file(path, field="[prior] file")
    with reading(path, "a prior", field="[prior] file", remedy=_REMEDY):
        with h5py.File(path, "r") as file:
            described = json.loads(file.attrs["basis"])
            if described != json.loads(json.dumps(basis.describe())):
                remedy = "make it with this job's [basis] and [beam]"
                raise InputError("is of another basis", field="basis", remedy=remedy)
            n = basis.n_modes
            mean = _numbers(file, "mean", (n,), basis.is_complex)
            covariance = _numbers(file, "covariance", (n, n), basis.is_complex)
        _check_covariance(covariance)
        return CovariancePrior(mean, covariance)


def _numbers(file: h5py.File, name: str, shape: tuple[int, ...], may_be_complex: bool) -> Array:
    """Read one data set, and make sure that it is what the basis asks for."""
    if name not in file:
        raise InputError("is missing", field=name, remedy=_REMEDY)
    stored = file[name]
    if stored.shape != shape:
        raise InputError(
            f"has the shape {stored.shape}, but the basis has {shape[0]} modes", field=name, remedy=_REMEDY
        )
    if stored.dtype.kind not in ("iufc" if may_be_complex else "iuf"):
        wanted = "numbers" if may_be_complex else "real numbers, as the coefficients of this basis are"
        raise InputError(f"holds values of type {stored.dtype}, not {wanted}", field=name, remedy=_REMEDY)
    values: Array = np.asarray(stored[()], dtype=np.complex128 if stored.dtype.kind == "c" else np.float64)
    if not np.all(np.abs(values) <= LARGEST):
        raise InputError("holds values that are NaN, infinite or absurdly large", field=name, remedy=_REMEDY)
    return values


def _check_covariance(covariance: Array) -> None:
    """Make sure that a matrix is Hermitian with positive variances; `CovariancePrior` sees to the rest."""
    variance = np.diag(covariance).real
    if not np.all(variance > 0):
        worst: Any = int(np.argmin(variance))
        told = f"the variance of mode {worst} is {variance[worst]:.3g}, not positive"
        raise InputError(told, field="covariance", remedy=_REMEDY)
    sigma = np.sqrt(variance)
    difference = np.abs(covariance - covariance.conj().T) / sigma / sigma[:, np.newaxis]
    if difference.max() > ROUNDING:
        i, j = np.unravel_index(int(np.argmax(difference)), difference.shape)
        told = f"is no covariance: elements ({i}, {j}) and ({j}, {i}) are not conjugates of one another"
        raise InputError(told, field="covariance", remedy=_REMEDY)
