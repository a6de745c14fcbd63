"""What no data tell of gains is found and taken off, phases that wrap included."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.degenerate_gains import without_degenerate

RNG = np.random.default_rng(3)
SCATTERED = RNG.uniform(-60, 60, (20, 2))
HEXAGON = np.array([[14.6 * (i + j / 2), 12.6 * j] for i in range(5) for j in range(5)])


@pytest.mark.parametrize("gradient", [(0.0, 0.0), (0.004, -0.002), (0.11, 0.07)])
@pytest.mark.parametrize("positions", [SCATTERED, HEXAGON])
def test_what_is_left_is_what_was_there_before(positions: np.ndarray, gradient: tuple[float, float]) -> None:
    amplitude, phase = 0.02 * RNG.normal(size=(2, len(positions)))
    plain = without_degenerate(amplitude, phase, positions)
    wrapped = np.angle(np.exp(1j * (phase + 2.5 + positions @ np.array(gradient))))
    left = without_degenerate(amplitude - 0.3, wrapped, positions)
    np.testing.assert_allclose(left[0], plain[0], atol=1e-12)
    np.testing.assert_allclose(left[1], plain[1], atol=1e-12)
    assert left[2].ln_amplitude - plain[2].ln_amplitude == pytest.approx(-0.3)
    np.testing.assert_allclose(left[2].gradient, np.add(plain[2].gradient, gradient), atol=1e-12)
    assert np.cos(left[2].phase - plain[2].phase - 2.5) == pytest.approx(1)
    assert abs(left[1].mean()) < 1e-12


def test_antennas_that_are_not_known_stay_so() -> None:
    amplitude, phase = 0.02 * RNG.normal(size=(2, len(SCATTERED)))
    amplitude[3] = phase[3] = np.nan
    left = without_degenerate(amplitude, phase, SCATTERED)
    assert np.isnan(left[0]).tolist() == np.isnan(left[1]).tolist() == np.isnan(amplitude).tolist()
    known = np.isfinite(phase)
    again = without_degenerate(amplitude[known], phase[known], SCATTERED[known])
    np.testing.assert_allclose(left[1][known], again[1], atol=1e-12)
    nothing = np.full(4, np.nan)
    assert np.isnan(without_degenerate(nothing, nothing, SCATTERED[:4])[0]).all()


def test_antennas_in_a_line_have_a_gradient_along_it() -> None:
    line = np.column_stack([14.6 * np.arange(6.0), np.zeros(6)])
    _, left, found = without_degenerate(np.zeros(6), 0.05 * line[:, 0] + 0.1, line)
    np.testing.assert_allclose(left, 0, atol=1e-12)
    assert found.gradient == pytest.approx((0.05, 0.0), abs=1e-12)
