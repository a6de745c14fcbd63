"""What a channel says of the model and of one candidate after it, kept without what all candidates share."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.candidate_rows import Beside
from hydrabeam_mpi.random import generator


def likelihood(n: int) -> Likelihood:
    rng = generator(5, "likelihood", n)
    root, more = rng.standard_normal((2, n, n))
    information = root @ root.T
    return Likelihood(information, rng.standard_normal(n), information + more @ more.T)


@pytest.mark.parametrize("q", [0, 4])
def test_the_whole_is_put_together_again(q: int) -> None:
    whole = likelihood(7)
    model = whole.first(q)
    kept = Beside.of(model, whole)
    again = kept.whole()
    assert kept.model is model
    np.testing.assert_array_equal(again.information, whole.information)
    np.testing.assert_array_equal(again.score, whole.score)
    np.testing.assert_array_equal(again.signal[q:, q:], whole.signal[q:, q:])
    np.testing.assert_array_equal(again.signal[:q, :q], whole.signal[:q, :q])
    np.testing.assert_array_equal(kept.of_first(2).whole().information, whole.first(q + 2).information)


def test_what_is_left_of_it_is_as_of_the_whole() -> None:
    whole = likelihood(9)
    again = Beside.of(whole.first(5), whole).whole()
    one, two = (each.marginalised(np.arange(5), np.eye(5)) for each in (whole, again))
    for name in ("information", "score", "signal"):
        np.testing.assert_allclose(getattr(two, name), getattr(one, name), rtol=1e-12)
