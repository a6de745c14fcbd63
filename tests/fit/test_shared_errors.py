"""Rows whitened by the errors that they share, against roots of whole covariances."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray
from hydrabeam_mpi.fit.shared_errors import Felt, SharedErrors, whitening_coefficients
from hydrabeam_mpi.fit.whitening import TimeWhitener
from hydrabeam_mpi.random import complex_normal, generator


def parts(rows: ComplexArray) -> FloatArray:
    """Real parts before imaginary ones, along the first axis."""
    return np.concatenate([rows.real, rows.imag])


def symmetric_root(covariance: FloatArray) -> FloatArray:
    """The inverse of the symmetric root of 1 + a covariance."""
    values, vectors = np.linalg.eigh(np.eye(len(covariance)) + covariance)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


COLUMNS = {
    "fewer parameters than rows": (3, 3),
    "more parameters than rows": (40, 40),
    "parameters that are the same": (4, 2),
    "one parameter": (1, 1),
}


ALONE = TimeWhitener.of(np.full(5, 0.5), np.array([0, 0, 1, 2, 2]), np.zeros((0, 6)))
"""Rows whose noise has variance one in either part, with no beam; some of them are redundant."""


def shared_rows(q: int, rank: int, is_of_groups: BoolArray) -> tuple[list[ComplexArray], list[Felt], FloatArray]:
    """Rows of four times, how they feel the parameters, and the covariance of these."""
    rng = generator(4, "shared", q)
    mixed = rng.standard_normal((rank, q))
    felt = [
        Felt(
            (complex_normal(rng, (5, rank)) @ mixed)[:, ~is_of_groups],
            (complex_normal(rng, (3, rank)) @ mixed)[:, is_of_groups],
            is_of_groups,
        )
        for _ in range(4)
    ]
    root = rng.standard_normal((q, q))
    return [complex_normal(rng, (5,)) for _ in range(4)], felt, root @ root.T


def columns(felt: Felt) -> ComplexArray:
    """Return how each of the five rows feels all parameters, in their order."""
    every = np.zeros((5, len(felt.is_of_groups)), dtype=complex)
    every[:, ~felt.is_of_groups], every[:, felt.is_of_groups] = felt.own, felt.of_groups[[0, 0, 1, 2, 2]]
    return every


@pytest.mark.mpi
@pytest.mark.parametrize("alike", [0.0, 0.5, 1.0], ids=["no column of groups", "some", "all columns of groups"])
@pytest.mark.parametrize(("q", "rank"), COLUMNS.values(), ids=COLUMNS)
def test_shared_errors_are_whitened_over_all_rows(q: int, rank: int, alike: float, comm: MPI.Comm) -> None:
    """Whichever rank has which times."""
    is_of_groups = generator(6, "of groups", q).random(q) < alike
    z, felt, covariance = shared_rows(q, rank, is_of_groups)
    errors = SharedErrors(covariance)
    mine = range(comm.rank, 4, comm.size)
    for t in mine:
        errors.add(ALONE, z[t], felt[t])
    errors.complete(comm)
    (coefficients,), (felt_by,) = whitening_coefficients([errors], np.zeros(q, dtype=bool), comm, comm.rank == 0)
    jacobian = parts(np.concatenate(list(map(columns, felt))))
    whole = jacobian @ covariance @ jacobian.T
    white = symmetric_root(whole) @ parts(np.concatenate(z))
    expected = (white[:20] + 1j * white[20:]).reshape(4, 5)
    for t, change in zip(mine, errors.changes(coefficients), strict=True):
        np.testing.assert_allclose(z[t] + change, expected[t], rtol=0, atol=1e-9)
    n_felt = np.trace(np.linalg.solve(np.eye(40) + whole, whole))
    assert felt_by == pytest.approx(n_felt, rel=1e-9)
    assert felt_by <= (rank if alike in (0.0, 1.0) else 2 * rank)


def test_errors_that_nothing_feels_change_nothing() -> None:
    errors = SharedErrors(np.eye(2))
    nothing = Felt(np.zeros((5, 1), complex), np.zeros((3, 1), complex), np.array([False, True]))
    errors.add(ALONE, np.ones(5, complex), nothing)
    alone = MPI.COMM_SELF
    (coefficients,), felt_by = whitening_coefficients([errors.complete(alone)], np.array([True, False]), alone, True)
    assert not errors.changes(coefficients)[0].any()
    assert felt_by == [0]


SHARED = {
    "none": np.zeros(4, dtype=bool),
    "some": np.array([False, True, True, False]),
    "all": np.ones(4, dtype=bool),
    "one without errors": np.array([True, True, False, False]),
}


def arrow(shared: BoolArray, certain: bool) -> tuple[list[FloatArray], FloatArray]:
    """Covariances of four parameters in each of two channels, and of all eight: they are independent given the shared.

    Where one is ``certain``, the first shared one has no error.
    """
    rng = generator(11, "arrow")
    n = int(np.count_nonzero(shared))
    root, place = rng.standard_normal((n + 2 * (4 - n), n + 2 * (4 - n))), np.zeros((8, n + 2 * (4 - n)))
    root[:n, n:] = 0
    for channel in range(2):
        own = slice(n + channel * (4 - n), n + (channel + 1) * (4 - n))
        other = slice(n + (1 - channel) * (4 - n), n + (2 - channel) * (4 - n))
        root[own, other] = 0
        place[4 * channel + np.flatnonzero(shared), np.arange(n)] = 1
        place[4 * channel + np.flatnonzero(~shared), np.arange(own.start, own.stop)] = 1
    if certain:
        root[0], root[:, 0] = 0, 0
    of_all = place @ root @ root.T @ place.T
    return [of_all[:4, :4], of_all[4:, 4:]], of_all


@pytest.mark.mpi
@pytest.mark.parametrize("name", SHARED)
def test_rows_of_channels_are_whitened_by_what_they_share(name: str, comm: MPI.Comm) -> None:
    """Whichever rank has which times: what was one covariance of the rows of both channels is one of noise alone."""
    shared, is_of_groups = SHARED[name], np.array([False, True, False, True])
    covariances, of_all = arrow(shared, name == "one without errors")
    felt = [shared_rows(4, 4, is_of_groups)[1], shared_rows(4, 3, is_of_groups)[1]]
    mine = range(comm.rank, 4, comm.size)

    def whitened(z: ComplexArray) -> tuple[ComplexArray, list[float]]:
        """Rows of both channels, (2, 4, 5)."""
        each = [SharedErrors(one) for one in covariances]
        for channel, errors in enumerate(each):
            for t in mine:
                errors.add(ALONE, z[channel, t], felt[channel][t])
            errors.complete(comm)
        coefficients, felt_by = whitening_coefficients(each, shared, comm, comm.rank == 0)
        changed = np.zeros_like(z)
        for channel, errors in enumerate(each):
            changed[channel, list(mine)] = errors.changes(coefficients[channel])
        return z + comm.allreduce(changed), felt_by

    columns_of_all = [parts(np.concatenate(list(map(columns, one)))) for one in felt]
    jacobian = np.block(
        [
            [columns_of_all[0], np.zeros((40, 4))],
            [np.zeros((40, 4)), columns_of_all[1]],
        ]
    )
    covariance = np.eye(80) + jacobian @ of_all @ jacobian.T
    whitening = np.zeros((80, 80))
    for i, unit in enumerate(np.eye(80).reshape(80, 2, 2, 4, 5)):
        found, felt_by = whitened(unit[:, 0] + 1j * unit[:, 1])
        whitening[:, i] = np.stack([found.real, found.imag], axis=1).reshape(80)
    np.testing.assert_allclose(whitening @ covariance @ whitening.T, np.eye(80), rtol=0, atol=1e-9)
    assert sum(felt_by) == pytest.approx(80 - np.trace(np.linalg.inv(covariance)), rel=1e-9)
