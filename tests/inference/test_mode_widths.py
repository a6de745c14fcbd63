"""Widths of coefficients by the model's, by those beside them and by their orders."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.inference.mode_widths import ModeSizes, PriorWidths

ORDERS = np.array([[0, 0], [1, 0], [2, 0], [4, 0], [0, 2], [1, 2], [1, 2]])
SIZES = ModeSizes(np.array([5.0, 1.0, 2.0, 0.5, 0.1, 3.0, 4.0]), ORDERS, 8.0)


def test_a_coefficient_counts_as_large_as_those_beside_it() -> None:
    """Of the same azimuthal order, and of radial orders that differ by one at most."""
    np.testing.assert_array_equal(SIZES.envelope, [5, 5, 2, 0.5, 4, 4, 4])


def test_widths_are_of_two_parts() -> None:
    proportional, smooth = SIZES.widths(PriorWidths(0.1, 0.01, (0.5, 1.0)))
    np.testing.assert_allclose(proportional, 0.1 * SIZES.amplitudes)
    np.testing.assert_allclose(smooth, 0.08 * np.exp(-np.array([0, 0.5, 1, 2, 2, 2.5, 2.5])))
    proportional, _ = SIZES.widths(PriorWidths(0.1, neighbours=True))
    np.testing.assert_allclose(proportional, 0.1 * SIZES.envelope)


def test_azimuthal_orders_have_factors_where_they_are_given() -> None:
    """More or fewer than there are orders."""
    plain = np.array(SIZES.widths(PriorWidths(0.1, 0.01)))
    for azimuthal, expected in (
        ((2.0,), [2, 2, 2, 2, 1, 1, 1]),
        ((2.0, 7.0, 0.5, 9.0), [2, 2, 2, 2, 0.5, 0.5, 0.5]),
    ):
        widths = np.array(SIZES.widths(PriorWidths(0.1, 0.01, azimuthal=azimuthal)))
        np.testing.assert_allclose(widths, plain * expected)
