"""The pairs of leading parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.report.beam.corner import N_EFFECTS, N_MODES, draw_corner, leading
from hydrabeam_mpi.report.page.result import Channel


def test_the_coefficients_that_moved_most(bands_channel: Channel) -> None:
    arrays, covariance = bands_channel.arrays, bands_channel.covariance()
    names, joint = leading(bands_channel, covariance)
    moved = np.abs(arrays["mean"] - arrays["prior_mean"]) / arrays["std"]
    modes = sorted(np.argsort(-moved)[:N_MODES].tolist())
    assert names == [f"mode {mode + 1}" for mode in modes]
    np.testing.assert_array_equal(joint, covariance[np.ix_(modes, modes)])


def test_effects_stand_beside_them_with_their_correlations(bands_channel: Channel) -> None:
    n, rng = len(bands_channel.arrays["mean"]), np.random.default_rng(1)
    spread, response = np.diag([1.0, 4.0, 9.0, 16.0]), rng.normal(size=(n, 4))
    entry = {"names": list("abcd"), "values": [[5.0, -30.0, 0.0, 8.0]], "std": [[1.0, 2.0, 3.0, 4.0]]}
    arrays = bands_channel.arrays | {"effects_covariance": spread, "effects_beam_response": response}
    channel = replace(bands_channel, arrays=arrays, effects=[entry])
    covariance = bands_channel.covariance() + response @ spread @ response.T
    names, joint = leading(channel, covariance)
    assert names[-N_EFFECTS:] == ["a", "b", "d"]
    modes = [int(name.split()[1]) - 1 for name in names[:-N_EFFECTS]]
    np.testing.assert_allclose(joint[:-3, -2], 4.0 * response[modes, 1])
    assert np.linalg.eigvalsh(joint).min() > 0
    drawing = draw_corner(channel, covariance)
    assert drawing is not None
    text = [axes.texts[0].get_text() for axes in drawing.figure.axes if axes.texts]
    assert len(text) == len(names) * (len(names) - 1) // 2
    correlation = joint[1, 0] / np.sqrt(joint[0, 0] * joint[1, 1])
    assert text[0] == f"{correlation:+.2f}".replace("-", "−")
