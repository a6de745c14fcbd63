"""Errors where the fitted data have more left than the noise that is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Values
from tests.fit.test_gauss_newton import free
from tests.loop.mock import context_of, mock_job


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_noise_that_is_larger_than_stated(scale: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    """By its factor, with its error of half of one over the root of the degrees of freedom; one where it is right.

    In the gains, which noise alone has moved, true errors are told: they scatter by as much as is said of them.
    """
    noise = {"kind": "noise_level", "parameters": {"noise scale": scale}}
    gain = {"kind": "antenna_gains", "parameters": {"antenna 0 phase": 0.02}}
    context = context_of(mock_job(noise, gain, n_times=30), tmp_path_factory.mktemp("scaled"))
    fitted = refit(context, Values((free(context, AntennaGains(), 0.3),)))
    found = error_scale(context, fitted)
    if scale == 1:
        assert found.channels[0] < 1.05
    else:
        assert found.channels[0] == pytest.approx(scale, rel=3 / np.sqrt(fitted.diagnostics.n_data[0]))
    assert found.together == found.channels[0]
    (active,), (std,) = fitted.values.active, fitted.fit.std
    errors = found.of(active, std)
    used = errors[0, active.used] < 0.5 * active.prior.of(0).std()
    truth = np.where([name == "antenna 0 phase" for name, _ in active.labels(context.setup)], 0.02, 0.0)
    truth = truth - (truth @ np.linalg.pinv(active.held)) @ active.held
    z = ((active.x[0, active.used] - truth) / errors[0, active.used])[used]
    assert len(z) > 8
    assert 0.5 < np.std(z) < 1.5


def test_a_chi2_above_one_by_less_than_its_sampling_error_is_one(tmp_path_factory: pytest.TempPathFactory) -> None:
    context = context_of(mock_job(), tmp_path_factory.mktemp("as it is"))
    alone = refit(context, Values())
    own = alone.diagnostics
    free_data = own.n_data - 0.5 * own.effective_parameters
    for sigmas, larger in ((0.5, False), (5.0, True)):
        chi2 = (free_data + sigmas * np.sqrt(free_data)) / own.n_data
        at = replace(alone, diagnostics=replace(own, train_chi2=chi2))
        assert (error_scale(context, at).channels[0] > 1) == larger
