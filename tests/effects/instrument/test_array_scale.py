from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.array_scale import ArrayScale, Wrong
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.refits import with_best_variant
from tests.effects.direct import assert_same, row_vectors, visibilities
from tests.effects.small import small_block, small_setup, with_effect
from tests.loop.mock import context_of, mock_job

CHANNELS = (131e6, 151e6)
SETUP = small_setup(CHANNELS, n_sources=500)


@pytest.mark.parametrize(("wrong", "factor"), [("positions", 1.02), ("frequencies", 1 + 0.02 * 141 / 131)])
def test_baselines_are_longer_by_a_factor_and_the_beam_stays(wrong: Wrong, factor: float) -> None:
    """Frequencies that are 2.82 MHz too low count more in the lower channel."""
    block, effect = small_block(SETUP), ArrayScale(wrong)
    block.integrate_for([effect])
    seen = with_effect(effect, block, np.array([2.0]))
    assert_same(seen, visibilities(block, vectors=factor * row_vectors(block)), block)


def test_what_is_told_is_in_the_units_of_what_is_wrong() -> None:
    one = replace(SETUP, observation=replace(SETUP.observation, freqs=SETUP.observation.freqs[:1]))
    x = np.full((1, 1), 0.2)
    for effect, setup, name, value in (
        (ArrayScale(), SETUP, "baselines longer than stated", 0.2),
        (ArrayScale(), one, "baselines longer, or the frequency higher, than stated", 0.2),
        (ArrayScale("frequencies"), SETUP, "frequencies higher than stated", 282.0),
    ):
        told = effect.told(setup, x, x)
        assert told.names == (name,)
        assert told.units == ("kHz" if effect.wrong == "frequencies" else "%",)
        np.testing.assert_allclose([told.values, told.std], value)
    assert ArrayScale().variants(one) == []


@pytest.mark.parametrize("wrong", ["positions", "frequencies"])
def test_channels_tell_which_of_the_two_is_wrong(wrong: Wrong, tmp_path: Path) -> None:
    truth = {"kind": "array_scale", "settings": {"wrong": wrong}, "parameters": {"baselines longer than stated": 0.5}}
    context = context_of(mock_job(truth, freqs=CHANNELS), tmp_path)
    start = Active.start(ArrayScale(), context.setup, np.ones(1), np.zeros((1, 1)))
    fitted = with_best_variant(context, refit(context, Values((start,))))
    (active,) = fitted.values.active
    assert active.effect.describe() == {"wrong": wrong}
    assert fitted.diagnostics.train_chi2.max() < 1.2
    assert abs(active.x[0, 0] - 0.5) < 4 * fitted.fit.std[0][0, 0]
