"""What goes on in time with a known covariance: its modes make that covariance up."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.effects.registry import laws_of, make_effect
from hydrabeam_mpi.effects.shared.correlated_law import COVARIANCES, LEFT_OUT, Correlated
from hydrabeam_mpi.errors import InputError
from tests.effects.cases import experiment_of

FIRST = 2459866.6
LATER = np.sort(np.random.default_rng(1).uniform(0, 180, 40))
"""Minutes."""


@pytest.mark.parametrize("kernel", COVARIANCES)
def test_numbers_of_equal_width_have_its_covariance(kernel: str) -> None:
    """At any times, whatever grid the modes are of."""
    law = Correlated((FIRST, FIRST + 180 / 1440), kernel=kernel, minutes=45.0).over(np.zeros(0))
    functions = law.functions(FIRST + LATER / 1440)
    assert 4 < functions.shape[1] < 40
    expected = COVARIANCES[kernel](LATER, 45.0)
    np.testing.assert_allclose(functions @ functions.T, expected, atol=0.02)
    assert np.mean(1 - np.sum(functions**2, axis=1)) == pytest.approx(0, abs=2 * LEFT_OUT)


def test_dpss_are_as_many_as_there_are_half_periods_and_a_few() -> None:
    law = Correlated((FIRST, FIRST + 0.5), kernel="dpss", minutes=72.0).over(np.zeros(0))
    assert 20 <= len(law.modes) <= 26


def test_it_is_found_again_from_what_describes_it() -> None:
    setup = experiment_of((131e6,), 8, 60)
    gains = make_effect("antenna_gains", {"law": "correlated", "kernel": "dpss", "minutes": 120}).in_full(setup)
    again = make_effect("antenna_gains", gains.describe())
    assert again.describe() == gains.describe()
    assert again.parameters(setup).names == gains.parameters(setup).names
    assert gains.parameters(setup).names[0] == "antenna 0 ln amplitude, mode 0"


def test_it_is_not_looked_for() -> None:
    assert "correlated" not in {effect.law for effect in laws_of("antenna_gains")}


@pytest.mark.parametrize("settings", [{"kernel": "box"}, {"minutes": 0}, {"modes": [-1]}])
def test_what_it_does_not_know_is_refused(settings: dict[str, object]) -> None:
    with pytest.raises(InputError, match="are not understood"):
        make_effect("antenna_gains", {"law": "correlated", **settings})
