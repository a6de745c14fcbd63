"""Functions of several bases side by side; what every basis does is in test_bases."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.joined import Joined, join
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.random import generator


def test_functions_are_those_of_the_parts_in_their_order() -> None:
    za, az = generator(1, "joined").uniform(0, 1.5, (2, 40))
    bessel, zernike = FourierBessel.full(3, 2, form="complex"), Zernike(2)
    every = np.concatenate([bessel.evaluate(za, az), zernike.evaluate(za, az)])
    np.testing.assert_array_equal(Joined([bessel, zernike]).evaluate(za, az), every)
    some = Joined([bessel, zernike], [20, 0, 7])
    np.testing.assert_array_equal(some.evaluate(za, az), every[[20, 0, 7]])
    again = Joined([zernike, Joined([some], [2, 0])])
    np.testing.assert_array_equal(again.evaluate(za, az)[-2:], every[[7, 20]])
    assert [part.describe()["kind"] for part in again.parts] == ["zernike", "fourier_bessel", "zernike"]


def test_modes_on_one_disc_are_one_basis() -> None:
    """In their order; not those of another condition at the edge, or ones that are there already."""
    full, (za, az) = FourierBessel.full(3, 2), generator(2, "joined").uniform(0, 1.5, (2, 40))
    some, others = full.with_modes(full.modes[:4]), full.with_modes(full.modes[4:])
    made = join([others, some])
    assert isinstance(made, FourierBessel)
    assert made.modes == full.modes[4:] + full.modes[:4]
    few = join([some, Joined([others])], [5, 2])
    assert isinstance(few, Joined)
    np.testing.assert_array_equal(few.evaluate(za, az), full.evaluate(za, az)[[5, 2]])
    for other in (some, FourierBessel.full(3, 2, boundary="neumann"), Zernike(1)):
        apart = join([some, other])
        assert isinstance(apart, Joined)
        assert len(apart.parts) == 2


def test_a_table_is_of_all_parts_and_there_is_none_where_one_part_has_none() -> None:
    full, (za, az) = FourierBessel.full(3, 2), generator(2, "joined").uniform(0, 1.5, (2, 40))
    other = FourierBessel.full(2, 3, form="complex", boundary="neumann")
    for basis in (join([full], [5, 2]), join([full, other]), join([other, full], [1, 0, 20])):
        coeffs = generator(3, "joined").standard_normal(basis.n_modes)
        table = basis.table(coeffs)
        assert table is not None
        np.testing.assert_allclose(table(za, az), basis.synthesize(coeffs, za, az).real, atol=3e-6)
    assert join([full, Zernike(1)]).table(np.ones(full.n_modes + 3)) is None
