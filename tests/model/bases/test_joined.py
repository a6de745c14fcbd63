"""Functions of several bases side by side; what every basis does is in test_bases."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.joined import Joined
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
