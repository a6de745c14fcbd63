"""Parameters that are marginalised with a prior, against dense Gaussians."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.prior import CovariancePrior, DiagonalPrior, FlatPrior, Prior, precision_of
from hydrabeam_mpi.random import generator

ROOT = generator(1, "covariance").standard_normal((3, 6)) * np.array([1e-3, 1.0, 1e3])[:, np.newaxis]
PRIORS: list[tuple[str, Prior]] = [
    ("independent", DiagonalPrior(np.zeros(3), np.array([1e-3, 1.0, 1e3]))),
    ("correlated", CovariancePrior(np.zeros(3), ROOT @ ROOT.T)),
    ("flat", FlatPrior(np.zeros(3))),
]


@pytest.mark.parametrize("prior", [prior for _, prior in PRIORS], ids=[name for name, _ in PRIORS])
@pytest.mark.parametrize("which", [[0, 1, 2], [4, 0, 2]])
def test_what_is_left_is_a_part_of_the_inverse(prior: Prior, which: list[int]) -> None:
    """Its mean and covariance are those that the others have among all parameters."""
    rng = generator(2, "information")
    columns = rng.standard_normal((6, 20))
    likelihood = Likelihood(columns @ columns.T, columns @ rng.standard_normal(20), columns @ columns.T)
    rest = [i for i in range(6) if i not in which]
    whole = likelihood.information.copy()
    whole[np.ix_(which, which)] += precision_of(prior)
    covariance = np.linalg.inv(whole)
    found = likelihood.marginalised(np.array(which), precision_of(prior))
    np.testing.assert_allclose(np.linalg.inv(found.information), covariance[np.ix_(rest, rest)], rtol=1e-8)
    mean = covariance @ likelihood.score
    np.testing.assert_allclose(np.linalg.solve(found.information, found.score), mean[rest], rtol=1e-8)
    np.testing.assert_array_equal(found.signal, likelihood.signal[np.ix_(rest, rest)])


def test_most_gain_is_that_of_the_most_probable_values() -> None:
    """Also where the data do not tell some combinations of the parameters."""
    columns = generator(3, "few data").standard_normal((6, 4))
    data = generator(4, "few data").standard_normal(4)
    likelihood = Likelihood(columns @ columns.T, columns @ data, columns @ columns.T)
    x = np.linalg.lstsq(columns.T, data, rcond=None)[0]
    gain = likelihood.score @ x - 0.5 * x @ likelihood.information @ x
    assert likelihood.most_gain() == pytest.approx(gain, rel=1e-9)
    # Whatever the units of the parameters are.
    units = np.array([1e-7, 1.0, 1e6, 1e3, 1e-3, 1.0])
    columns *= units[:, np.newaxis]
    likelihood = Likelihood(columns @ columns.T, columns @ data, columns @ columns.T)
    assert likelihood.most_gain() == pytest.approx(gain, rel=1e-6)
    assert Likelihood(np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2))).most_gain() == 0.0
