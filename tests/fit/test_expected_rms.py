"""What is expected of a held-out residual counts all that is uncertain of the model, effects too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.predictions import check
from tests.loop.mock import context_of, mock_job

N_DRAWS = 16


def test_a_residual_is_as_large_as_expected_where_each_baseline_has_parameters_of_its_own(tmp_path: Path) -> None:
    """Of eight fitted times couplings are known to an eighth of the noise's variance, far more than the beam is.

    Sixteen draws of noise tell the ratio to 3%; without what is uncertain of the couplings it is 1.1.
    """
    ratios, without = [], []
    for seed in range(N_DRAWS):
        context = context_of(mock_job() | {"seed": seed}, tmp_path / str(seed), MPI.COMM_SELF)
        effect = CrossCoupling().at(context.setup, np.arange(context.setup.observation.Nbls))
        n_params = len(effect.parameters(context.setup))
        coupling = Active.start(effect, context.setup, np.full(n_params, 1e6), np.zeros((1, n_params)))
        numbers = check(context, refit(context, Values((coupling,)))).numbers.of_all
        ratios.append((numbers["rms"] / numbers["rms_expected"]) ** 2)
        without.append((numbers["rms"] / numbers["rms_noise"]) ** 2)
    error = np.std(ratios, ddof=1) / np.sqrt(N_DRAWS)
    assert abs(np.mean(ratios) - 1) < 3 * error
    assert np.mean(without) - 1 > 3 * error
