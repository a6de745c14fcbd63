"""What channels say of one candidate after another beside the same model."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import BoolArray
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.beside import Beside, KnownModel
from hydrabeam_mpi.loop.attribution.others import Others
from hydrabeam_mpi.random import generator

SHARED = {
    "nothing in the model": np.zeros(0, dtype=bool),
    "each channel's own": np.zeros(4, dtype=bool),
    "shared": np.ones(4, dtype=bool),
    "both": np.array([True, False, False, True, False]),
}


def likelihood(n: int, channel: int = 0) -> Likelihood:
    rng = generator(5, "likelihood", n, channel)
    root, more = rng.standard_normal((2, n, n))
    information = root @ root.T
    return Likelihood(information, rng.standard_normal(n), information + more @ more.T)


def model_of(shared: BoolArray, n_freqs: int) -> Others:
    """Whose prior has a scale and a centre of its own in each channel, but for what channels share."""
    rng, n = generator(6, "prior"), len(shared)
    variances, scores = rng.uniform(0.5, 2, (n_freqs, n)), rng.standard_normal((n_freqs, n))
    variances[:, shared], scores[:, shared] = variances[0, shared], scores[0, shared]
    return Others(shared, tuple(np.diag(1 / one) for one in variances), tuple(scores))


@pytest.mark.parametrize("q", [0, 4])
def test_what_is_about_a_candidate_is_taken_out_of_the_whole(q: int) -> None:
    whole = likelihood(7)
    kept = Beside.of(whole.first(q), whole)
    np.testing.assert_array_equal(kept.across, whole.information[:q, q:])
    np.testing.assert_array_equal(kept.own.information, whole.information[q:, q:])
    np.testing.assert_array_equal(kept.own.score, whole.score[q:])
    np.testing.assert_array_equal(kept.own.signal, whole.signal[q:, q:])
    first = kept.of_first(2)
    np.testing.assert_array_equal(first.across, whole.information[:q, q : q + 2])
    np.testing.assert_array_equal(first.own.information, whole.information[q : q + 2, q : q + 2])


@pytest.mark.parametrize("of_all", [False, True], ids=["channel by channel", "of all"])
@pytest.mark.parametrize("n_freqs", [1, 3])
@pytest.mark.parametrize("name", SHARED)
def test_what_is_left_is_as_of_the_whole(name: str, n_freqs: int, of_all: bool) -> None:
    """With the model marginalised in the matrix of both."""
    model, q = model_of(SHARED[name], n_freqs), len(SHARED[name])
    wholes = [likelihood(q + 3, f) for f in range(n_freqs)]
    told = [Beside.of(one.first(q), one) for one in wholes]
    expected = model.marginalised(wholes, of_all)
    if of_all and len(expected) > 1:
        expected = [sum(expected[1:], start=expected[0])]
    found = KnownModel(model, [one.model for one in told]).left(told, of_all)
    assert len(found) == len(expected)
    for one, two in zip(found, expected, strict=True):
        for part in ("information", "score", "signal"):
            np.testing.assert_allclose(getattr(one, part), getattr(two, part), rtol=1e-9, atol=1e-12)
