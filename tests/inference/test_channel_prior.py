"""Priors over channels: one for all of them, or another in each."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hydrabeam_mpi.inference.prior import ChannelPrior, CovariancePrior, DiagonalPrior, Prior
from hydrabeam_mpi.random import generator

ROOT = generator(1, "root").standard_normal((2, 4))
WIDE, CORRELATED = (
    DiagonalPrior(np.array([1.0, -2.0]), np.array([3.0, 0.5])),
    CovariancePrior(np.ones(2), ROOT @ ROOT.T),
)
DENSE = {
    id(WIDE): multivariate_normal(WIDE.mean, np.diag(WIDE.sigma**2)),
    id(CORRELATED): multivariate_normal(np.ones(2), ROOT @ ROOT.T),
}
CASES = [
    pytest.param(ChannelPrior((WIDE,)), [WIDE, WIDE, WIDE], id="the same in each channel"),
    pytest.param(ChannelPrior((CORRELATED, WIDE, CORRELATED)), [CORRELATED, WIDE, CORRELATED], id="another in each"),
    pytest.param(ChannelPrior((CORRELATED,), shared=True), [CORRELATED], id="channels share the parameters"),
]


@pytest.mark.parametrize(("prior", "counted"), CASES)
def test_the_density_is_that_of_all_channels(prior: ChannelPrior, counted: list[Prior]) -> None:
    """Up to a constant; shared parameters count once."""
    rng = generator(2, "x")
    one, two = (rng.standard_normal((3, 2)) for _ in range(2))
    expected = sum(
        DENSE[id(of)].logpdf(a) - DENSE[id(of)].logpdf(b) for of, a, b in zip(counted, one, two, strict=False)
    )
    assert prior.log_density(one) - prior.log_density(two) == pytest.approx(expected)
    assert prior.of(2) is counted[-1]


def test_shared_parameters_have_one_prior() -> None:
    with pytest.raises(ValueError, match="one prior"):
        ChannelPrior((WIDE, CORRELATED), shared=True)
