"""What counts as better of held-out data."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.loop.selection.heldout_score import fall_significance
from tests.loop.made import blocks


@pytest.mark.parametrize("chi2", [1.2, 1.4, 50.0])
def test_predictions_gain_nothing_by_being_wider(chi2: float) -> None:
    """With all variances larger by a tenth chi^2 falls, and what is not of the noise's own level stays."""
    before = blocks(chi2)
    after = blocks(chi2 / 1.1, log_spread=before.n_data * np.log(1.1))
    assert after.chi2 < before.chi2
    assert after.log_density_at_own_level == pytest.approx(before.log_density_at_own_level, rel=1e-12)
    # As plain predictive densities go, wider ones are better where chi^2 is too large and worse where it is not.
    assert after.log_density > before.log_density


def test_predictions_lose_by_being_wider_than_what_is_left() -> None:
    """Where all is modelled the scale of the errors is known: that of the noise."""
    before = blocks(0.9)
    after = blocks(0.9 / 1.1, log_spread=before.n_data * np.log(1.1))
    assert after.log_density_at_own_level < before.log_density_at_own_level - 10
    assert after.log_density_at_own_level == after.log_density


def test_nearer_predictions_gain() -> None:
    before, after = blocks(1.4), blocks(1.3, log_spread=20.0)
    assert after.log_density_at_own_level > before.log_density_at_own_level


def test_a_fall_is_significant_where_all_blocks_fall() -> None:
    before = blocks(2.0)
    assert fall_significance(before, blocks(2.0)) == 0
    assert fall_significance(before, blocks(1.5, seed=2)) > 5
    assert fall_significance(before, blocks(2.5, seed=2)) < -5
