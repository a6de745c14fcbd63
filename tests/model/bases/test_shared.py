"""One basis in place of several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.fourier_bessel import Form, FourierBessel
from hydrabeam_mpi.model.bases.shared import SharedBasis
from hydrabeam_mpi.model.bases.zernike import Zernike

ONE, OTHER = [(1, 0), (2, 0), (1, 2), (1, -2)], [(1, 2), (1, -2), (3, 1), (3, -1), (1, 0)]


def check(bases: Sequence[LinearBasis], n_modes: int) -> None:
    shared, rng = SharedBasis(bases), np.random.default_rng(1)
    za, az = rng.uniform(0, 1.5, 40), rng.uniform(0, 6.2, 40)
    rows = shared.basis.evaluate(za, az).T
    assert rows.shape == (40, n_modes)
    for number, one in enumerate(bases):
        np.testing.assert_allclose(shared.taken(number, rows), one.evaluate(za, az).T, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("form", ["real", "complex"])
def test_a_mode_that_several_have_is_there_once(form: Form) -> None:
    check([FourierBessel(ONE, form), FourierBessel(OTHER, form), FourierBessel(ONE, form)], 6)


def test_other_discs_have_other_functions() -> None:
    check([FourierBessel(ONE), FourierBessel(ONE, edge=1.6), FourierBessel(OTHER)], 4 + 4 + 5)


def test_a_basis_that_all_have_stays_as_it_is() -> None:
    basis = Zernike.from_settings({"max_degree": 3, "edge": 92.0})
    assert isinstance(basis, Zernike)
    again = Zernike.from_description(basis.describe())
    shared = SharedBasis([basis, again])
    assert shared.basis is basis
    rows = np.ones((2, basis.n_modes))
    assert shared.taken(1, rows) is rows
