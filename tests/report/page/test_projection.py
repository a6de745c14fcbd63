"""The disc against the geometry of the projection, computed by other means."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.report.page.projection import to_disc

ZA, AZ = np.deg2rad(np.arange(91.0)), np.deg2rad(np.arange(360.0))
GRID_ZA, GRID_AZ = np.meshgrid(ZA, AZ, indexing="ij")


def pixel_centres(pixels: int) -> tuple[np.ndarray, np.ndarray]:
    centres = (np.arange(pixels) + 0.5) * 2 / pixels - 1
    east, north = np.meshgrid(centres, centres)
    return east, north


def test_east_is_right_and_north_is_up() -> None:
    # The direction cosines are sin za = rho sqrt(2 - rho^2) times the unit vector on the disc.
    east, north = pixel_centres(101)
    stretch = np.sqrt(np.maximum(2 - east**2 - north**2, 0))
    for values, expected in (
        (np.sin(GRID_ZA) * np.cos(GRID_AZ), east * stretch),
        (np.sin(GRID_ZA) * np.sin(GRID_AZ), north * stretch),
    ):
        square = to_disc(values, ZA, AZ, 101)
        inside = np.isfinite(square)
        np.testing.assert_allclose(square[inside], expected[inside], atol=2e-4)


def test_equal_areas_are_equal_solid_angles() -> None:
    za = to_disc(GRID_ZA, ZA, AZ, 400)
    inside = np.isfinite(za)
    assert inside.mean() == pytest.approx(np.pi / 4, rel=1e-3)
    for degrees in (30, 60):
        assert np.mean(za[inside] < np.deg2rad(degrees)) == pytest.approx(1 - np.cos(np.deg2rad(degrees)), rel=2e-3)


def test_azimuth_wraps_without_a_seam() -> None:
    square = to_disc(np.cos(3 * GRID_AZ + 1), ZA, AZ, 201)
    east, north = pixel_centres(201)
    far = np.isfinite(square) & (np.hypot(east, north) > 0.1)
    np.testing.assert_allclose(square[far], np.cos(3 * np.arctan2(north, east) + 1)[far], atol=2e-3)


def test_outside_is_blank_and_gaps_stay_gaps() -> None:
    values = np.ones((91, 360))
    values[40:50, 80:100] = np.nan
    square = to_disc(values, ZA, AZ, 200)
    east, north = pixel_centres(200)
    assert np.isnan(square[np.hypot(east, north) > 1]).all()
    inside = np.hypot(east, north) < 0.999
    hole = np.isnan(square) & inside
    za, az = (
        np.rad2deg(np.arccos(1 - east**2 - north**2, where=inside, out=np.zeros_like(east))),
        np.rad2deg(np.arctan2(north, east)),
    )
    assert hole.any()
    assert np.all((za[hole] > 38.9) & (za[hole] < 50.1) & (az[hole] > 78.9) & (az[hole] < 100.1))


def test_a_grid_that_ends_early_leaves_a_blank_rim() -> None:
    square = to_disc(np.ones((61, 360)), ZA[:61], AZ, 200)
    assert np.isfinite(square).mean() == pytest.approx(np.pi / 4 * 0.5, rel=0.01)
