from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.loop.residuals.spectra import Spectrum
from hydrabeam_mpi.random import complex_normal, generator


def total(spectrum: Spectrum, z: np.ndarray) -> tuple[np.ndarray, int]:
    parts = list(spectrum.power(z))
    return sum(power for power, _ in parts), sum(len(samples) for _, samples in parts)


def test_a_tone_is_found_where_it_is() -> None:
    x = 30.0 * np.arange(16)
    spectrum = Spectrum.of(x)
    tone = np.exp(2j * np.pi * spectrum.values[3] * x)[:, np.newaxis]
    power, n = total(spectrum, tone)
    np.testing.assert_allclose(power, np.where(np.arange(16) == 3, 16.0, 0.0), atol=1e-9)
    assert n == 1


def test_irregular_samples() -> None:
    x = np.array([0.0, 1.0, 2.0, 5.0, 5.5])
    spectrum = Spectrum.of(x, whole=True)
    z = complex_normal(generator(1, "irregular"), (5, 3))
    expected = np.abs(np.exp(-2j * np.pi * np.outer(spectrum.values, x)) @ z) ** 2
    np.testing.assert_allclose(total(spectrum, z)[0], expected.sum(axis=1) / 5)


def test_nights_are_transformed_apart() -> None:
    night = 600.0 * np.arange(8)
    spectrum = Spectrum.of(np.concatenate([night, 86400 + night[:6], 2 * 86400 + night[:2]]))
    assert [len(run) for run in spectrum.runs] == [8, 6]
    z = complex_normal(generator(2, "nights"), (16, 1))
    expected = np.abs(np.fft.fft(z[:8, 0])) ** 2 / 8 + np.abs(np.fft.fft(z[8:14, 0], 8)) ** 2 / 6
    np.testing.assert_allclose(total(spectrum, z)[0], expected)


def test_flags_leave_the_expectation_alone() -> None:
    spectrum = Spectrum.of(np.arange(12.0))
    rng = generator(3, "flags")
    z = np.sqrt(2) * complex_normal(rng, (12, 9000))
    z[rng.random(z.shape) < 0.3] = np.nan
    power, n = total(spectrum, z)
    assert 0.9 * 9000 < n < 9000
    np.testing.assert_allclose(power / (2 * n), 1.0, atol=5 / np.sqrt(n))


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_to_transform(n: int) -> None:
    spectrum = Spectrum.of(np.arange(float(n)))
    assert len(spectrum.values) == 0
    assert list(spectrum.power(np.ones((n, 3), dtype=complex))) == []
