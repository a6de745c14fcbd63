"""Fringes by antennas' phases are those by exponentials, whichever vectors are differences of antennas."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.model.engines.antenna_pairs import find_pairs
from hydrabeam_mpi.model.engines.fringes import Fringes, plane_waves

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(-200.0, 200.0, (12, 3)) * [1, 1, 0.01]
ONE, TWO = np.triu_indices(len(POINTS), 1)
VECTORS = POINTS[TWO] - POINTS[ONE]


def directions(n: int) -> np.ndarray:
    found = RNG.normal(size=(3, n))
    return found / np.linalg.norm(found, axis=0)


@pytest.mark.parametrize(
    "vectors",
    [VECTORS, -VECTORS[::-1], np.concatenate([VECTORS, VECTORS[:7] + 0.02, np.zeros((1, 3))])],
    ids=["all", "turned", "some"],
)
def test_fringes(vectors: np.ndarray) -> None:
    fringes = Fringes(vectors, points=POINTS)
    assert fringes.pairs is not None
    assert len(fringes.pairs.rows) == len(VECTORS)
    towards, weights = directions(50), RNG.uniform(1, 2, 50)
    out = np.empty((2, len(vectors), 50))
    fringes.fill(out, towards, weights, 150e6)
    np.testing.assert_allclose(out[0] + 1j * out[1], weights * plane_waves(vectors, towards, 150e6), atol=1e-11)


def test_phases_are_those_of_the_antennas_that_are_asked_for() -> None:
    few = np.flatnonzero((ONE < 6) & (TWO < 6))
    pairs = find_pairs(VECTORS[few], POINTS)
    assert pairs is not None
    assert len(pairs.points) == 6


def test_exponentials_where_they_are_fewer() -> None:
    assert find_pairs(VECTORS[:3], POINTS) is None
    assert find_pairs(VECTORS + 0.02, POINTS) is None
    assert find_pairs(np.zeros((0, 3)), POINTS) is None
