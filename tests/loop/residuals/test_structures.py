from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.loop.residuals.cube import Layout, whole_baselines
from hydrabeam_mpi.loop.residuals.structures import noise_edge, structures
from tests.loop.white import everything, make_layout, noise

LAYOUT = make_layout()
SELF = MPI.COMM_SELF


def described(layout: Layout, z: np.ndarray, used: np.ndarray | None = None) -> dict:
    found = structures(SELF, whole_baselines(SELF, everything(layout, z, used), layout))
    assert found is not None
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    return found


def test_noise_stays_below_its_edge() -> None:
    sigmas = np.array([described(LAYOUT, noise(LAYOUT, seed))["structures"][0]["sigma"] for seed in range(40)])
    assert abs(sigmas.mean()) < 0.7
    assert sigmas.max() < 4


def test_edge_against_drawn_matrices() -> None:
    layout = make_layout(n_freqs=2, n_times=30)
    largest = [
        np.linalg.svd(noise(layout, seed).reshape(-1, layout.shape[2]), compute_uv=False)[0] for seed in range(100)
    ]
    mean, std = noise_edge(layout.shape[2], layout.shape[0] * layout.shape[1], 1.0)
    assert np.mean(largest) == pytest.approx(mean, abs=0.5 * std)
    assert np.std(largest) == pytest.approx(std, rel=0.35)


def test_a_planted_structure() -> None:
    pattern = noise(LAYOUT, 1)[:, :, 0]
    left = np.where((LAYOUT.observation.antenna_index == 3).any(axis=1), 1.0, 0.0)
    z = noise(LAYOUT) + 2 * pattern[..., np.newaxis] * left
    found = described(LAYOUT, z)
    first = found["structures"][0]
    assert first["sigma"] > 10
    assert len(found["structures"]) == 1
    assert first["antennas"][0]["what"] == LAYOUT.observation.antenna_numbers[3]
    assert first["antennas"][0]["share"] == pytest.approx(0.5, abs=0.02)
    told = [entry["what"] for entry in first["baselines"][:6]]
    expected = LAYOUT.observation.antpairs[left > 0].tolist()
    assert sorted(told) == sorted(expected)
    drawn = np.array(first["pattern"]["real"]) + 1j * np.array(first["pattern"]["imag"])
    assert drawn.shape == pattern.shape
    overlap = abs(np.vdot(drawn, pattern)) / np.linalg.norm(drawn) / np.linalg.norm(pattern)
    assert overlap > 0.97


def test_size_is_bounded() -> None:
    layout = make_layout(n_freqs=100, n_times=200, every=1)
    found = described(layout, noise(layout))
    pattern = found["structures"][0]["pattern"]
    assert np.shape(pattern["real"]) == (64, 64)
    assert len(pattern["freqs_hz"]) == len(pattern["jds"]) == 64


def test_nothing() -> None:
    unused = np.zeros(LAYOUT.shape, dtype=bool)
    assert structures(SELF, whole_baselines(SELF, everything(LAYOUT, noise(LAYOUT), unused), LAYOUT)) is None
