from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.loop.residuals.whiteness import antenna_scales, is_white
from hydrabeam_mpi.random import generator
from tests.loop.white import everything, make_layout, noise, sums_of

LAYOUT = make_layout()


@pytest.mark.parametrize("scale", [0.3, 1.0, 20.0])
@pytest.mark.parametrize("seed", range(10))
def test_noise_of_any_scale_is_white(seed: int, scale: float) -> None:
    white, why = is_white(sums_of(LAYOUT, scale * noise(LAYOUT, seed)), LAYOUT)
    assert white, why


def test_noise_of_each_antenna() -> None:
    scales = np.exp(generator(1, "scales").uniform(-0.7, 0.7, 7))
    one, two = LAYOUT.observation.antenna_index.T
    z = noise(LAYOUT) * np.sqrt(scales[one] * scales[two])
    sums = sums_of(LAYOUT, z)
    assert not is_white(sums, LAYOUT)[0]
    found = antenna_scales(sums, LAYOUT)
    np.testing.assert_allclose(found, scales, rtol=0.15)
    divided = everything(LAYOUT, z).divided(found, LAYOUT)
    white, why = is_white(sums_of(LAYOUT, divided.z), LAYOUT)
    assert white, why


def structured(kind: str) -> np.ndarray:
    z, other = noise(LAYOUT), noise(LAYOUT, 1)
    match kind:
        case "time":
            z[:, 4] += other[:, 4]
        case "constant":
            z += 0.5 * other[:, :1]
        case "redundant":
            z += 0.5 * other[..., LAYOUT.redundant.group]
        case "channels":
            z += 0.5 * other[:1]
        case "antenna":
            z[:, :, (LAYOUT.observation.antenna_index == 2).any(axis=1)] *= 1.3
        case "tail":
            z = np.where(generator(2, "tail").random(z.shape) < 0.01, 4 * z, z)
    return z


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("time", "times"),
        ("constant", "fringe_rates|fringe rates|neighbouring times"),
        ("redundant", "within redundant groups"),
        ("channels", "delays|neighbouring channels"),
        ("antenna", "antennas|baselines"),
        ("tail", "Gaussian|stand out"),
    ],
)
def test_structure_is_not_white(kind: str, words: str) -> None:
    white, why = is_white(sums_of(LAYOUT, 2.5 * structured(kind)), LAYOUT)
    assert not white
    assert any(word in why for word in words.split("|")), why
