"""What cannot be has no evidence, and does not take that of what can."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray
from hydrabeam_mpi.effects.interface.effect import Parameters
from hydrabeam_mpi.effects.interface.limits import sigmas
from hydrabeam_mpi.loop.attribution.evidence import Evidence, find_evidence, find_possible
from hydrabeam_mpi.loop.attribution.limits import is_unphysical
from tests.loop.attribution.test_evidence import make_model


def below_minus_one(found: Evidence) -> BoolArray:
    return is_unphysical(sigmas(-1.0 - found.x, found.std).max(axis=0), 5.0)


def test_an_element_beyond_its_limit_has_no_part() -> None:
    """Of three sources one has an error of -3, which would be a flux below zero, and another one of 9."""
    likelihood = make_model(3, 5, np.array([0.0, -3.0, 9.0])).likelihood
    names = [f"source {i}" for i in range(3)]
    parameters = Parameters.of(names, "", np.full(3, 0.1), np.arange(3), trials=300)
    free = find_evidence([likelihood], parameters)
    assert free.prior_var[1] > 0
    assert below_minus_one(free)[1]
    possible = find_possible([likelihood], parameters, None, below_minus_one)
    assert possible.prior_var[1] == 0
    assert possible.log_bayes_factor < free.log_bayes_factor
    only_others = find_evidence(
        [likelihood], Parameters.of(names, "", np.array([0.1, 0, 0.1]), np.arange(3), trials=300)
    )
    np.testing.assert_allclose(possible.prior_var, only_others.prior_var)
    assert possible.log_bayes_factor == only_others.log_bayes_factor


def test_where_nothing_can_be_nothing_has_evidence() -> None:
    likelihood = make_model(1, 6, np.array([-9.0])).likelihood
    parameters = Parameters.of(["source"], "", np.array([0.1]), np.arange(1), trials=300)
    found = find_possible([likelihood], parameters, None, below_minus_one)
    assert not found.prior_var.any()
    assert found.log_bayes_factor <= 0


def test_what_is_within_its_errors_of_a_limit_can_be() -> None:
    likelihood = make_model(2, 7, np.array([0.3, -1.0])).likelihood
    parameters = Parameters.of(["one", "other"], "", np.full(2, 0.1), np.arange(2), trials=300)
    free = find_evidence([likelihood], parameters)
    assert find_possible([likelihood], parameters, None, below_minus_one).log_bayes_factor == free.log_bayes_factor
