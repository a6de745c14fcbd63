"""Priors over channels: one for all of them, another in each, or one of all together."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from hydrabeam_mpi.inference.prior import (
    BlockPrior,
    ChannelPrior,
    CovariancePrior,
    DiagonalPrior,
    FlatPrior,
    Prior,
    precision_of,
)
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


def test_channels_that_are_coupled() -> None:
    """Density, its gradient and the prior of one channel, against the dense Gaussian of all channels together."""
    rng = generator(3, "coupled")
    mean, root = rng.standard_normal(6), rng.standard_normal((6, 9))
    covariance = root @ root.T
    prior = ChannelPrior((CovariancePrior(mean, covariance),), n_coupled=3)
    dense = multivariate_normal(mean, covariance)
    one, two = (rng.standard_normal((3, 2)) for _ in range(2))
    expected = dense.logpdf(one.ravel()) - dense.logpdf(two.ravel())
    assert prior.log_density(one) - prior.log_density(two) == pytest.approx(expected)
    np.testing.assert_allclose(prior.score(one).ravel(), np.linalg.solve(covariance, mean - one.ravel()))
    for f, span in enumerate((slice(0, 2), slice(2, 4), slice(4, 6))):
        np.testing.assert_allclose(prior.of(f).mean, mean[span])
        np.testing.assert_allclose(np.linalg.inv(precision_of(prior.of(f))), covariance[span, span])


def test_independent_and_identical_channels_are_cases_of_coupled_ones() -> None:
    """Independent ones exactly; those that share parameters in the limit of channels that hardly differ."""
    x, block = generator(4, "cases").standard_normal((3, 2)), ROOT @ ROOT.T
    several = [CovariancePrior(np.ones(2), (f + 1) * block) for f in range(3)]
    independent = block_diag(*((f + 1) * block for f in range(3)))
    together = ChannelPrior((CovariancePrior(np.ones(6), independent),), n_coupled=3)
    assert together.log_density(x) == pytest.approx(ChannelPrior(tuple(several)).log_density(x))
    np.testing.assert_allclose(together.score(x), ChannelPrior(tuple(several)).score(x))
    alike = np.kron(np.ones((3, 3)) + 1e-7 * np.eye(3), block)
    together = ChannelPrior((CovariancePrior(np.ones(6), alike),), n_coupled=3)
    x = np.broadcast_to(x[0], (3, 2))
    assert together.log_density(x) == pytest.approx(ChannelPrior((CORRELATED,), shared=True).log_density(x), rel=1e-6)


@pytest.mark.parametrize(
    "prior", [prior for prior, _ in (case.values for case in CASES)], ids=["same", "each", "shared"]
)
def test_the_score_is_the_gradient_of_the_density(prior: ChannelPrior) -> None:
    x = np.broadcast_to([0.3, -0.2], (3, 2)).copy()
    found = prior.score(x)
    for f, i in np.ndindex(1 if prior.shared else 3, 2):
        ahead, back = x.copy(), x.copy()
        ahead[f, i], back[f, i] = x[f, i] + 0.5, x[f, i] - 0.5
        assert found[f, i] == pytest.approx(prior.log_density(ahead) - prior.log_density(back))
    if prior.shared:
        np.testing.assert_array_equal(found, np.broadcast_to(found[0], (3, 2)))


def test_shared_parameters_have_one_prior() -> None:
    with pytest.raises(ValueError, match="one prior"):
        ChannelPrior((WIDE, CORRELATED), shared=True)
    with pytest.raises(ValueError, match="one prior"):
        ChannelPrior((WIDE, CORRELATED), n_coupled=2)
    with pytest.raises(ValueError, match="not coupled besides"):
        ChannelPrior((WIDE,), shared=True, n_coupled=2)


def test_blocks_side_by_side_are_the_whole_gaussian() -> None:
    rng = generator(5, "blocks")
    root = rng.standard_normal((3, 5))
    covariance, sigma = root @ root.T, rng.uniform(0.5, 2.0, 2)
    prior = BlockPrior((CovariancePrior(np.arange(3.0), covariance), DiagonalPrior(np.full(2, -1.0), sigma)))
    whole = np.zeros((5, 5))
    whole[:3, :3], whole[3:, 3:] = covariance, np.diag(sigma**2)
    np.testing.assert_array_equal(prior.mean, [0, 1, 2, -1, -1])
    np.testing.assert_allclose(precision_of(prior), np.linalg.inv(whole), atol=1e-10)
    np.testing.assert_allclose(prior.std(), np.sqrt(np.diag(whole)))
    vector = rng.standard_normal(5)
    np.testing.assert_allclose(prior.precision_times(vector), np.linalg.solve(whole, vector))
    assert prior.log_det_precision == pytest.approx(-np.linalg.slogdet(whole)[1])
    assert BlockPrior((*prior.priors, FlatPrior(np.zeros(2)))).log_det_precision is None
