"""Where rows are that were left out: what lost more than its share is named, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.noise.outliers import Outliers
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Fitted, Reweighted, Values
from hydrabeam_mpi.loop.residuals.left_out import _most_improbable, log_chance, rows_left_out
from hydrabeam_mpi.random import generator
from tests.loop.mock import FREQ, context_of, mock_job


@pytest.fixture(scope="module")
def context(comm: MPI.Comm, tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    """Two channels, on all ranks: seven antennas at 24 times."""
    job = mock_job(freqs=(FREQ, FREQ + 8e6), n_times=24)
    return context_of(job, comm.bcast(tmp_path_factory.mktemp("left_out")), comm)


class Chosen(Outliers):
    """Leaves out rows by their place, whatever they are."""

    def __init__(self, lost: FloatArray) -> None:
        self.lost = lost

    def weight_factor(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return zero for what is lost."""
        return 1.0 - self.lost[np.ix_(block.times, block.bls)]


def told(context: FitContext, lost: FloatArray) -> dict[str, Any]:
    fitted = refit(context, Values())
    change = Reweighted(Chosen(lost), np.zeros((2, 3)), np.zeros((2, 3)))
    found = rows_left_out(context, replace(fitted, values=Values(reweighted=(change,))))
    assert found is not None
    assert found["n"] == 2 * lost.sum()
    assert found["of"] == 2 * lost.size
    return found


@pytest.mark.mpi
def test_times_antennas_and_baselines_are_named(context: FitContext) -> None:
    """Each once: a baseline neither for its antenna nor for a time at which all are left out."""
    observation = context.setup.observation
    ends, lost = observation.antenna_index, np.zeros((24, observation.Nbls))
    lost[[5, 6, 7, 15]] = 1
    antenna, other = (ends == 4).any(axis=1), int(np.flatnonzero((ends != 4).all(axis=1))[0])
    lost[::3, antenna] = 1
    lost[::2, other] = 1
    found = told(context, lost)
    assert [one["integrations"] for one in found["times"]] == [3, 1]
    assert found["times"][0]["jd"] == observation.times[[5, 7]].tolist()
    assert [one["what"] for one in found["antennas"]] == [int(observation.antenna_numbers[4])]
    assert [one["what"] for one in found["baselines"]] == [observation.antpairs[other].tolist()]
    assert found["elsewhere"] == {"n": 0, "of": found["elsewhere"]["of"], "rows": []}
    assert f"of JD {observation.times[5]:.6f} to {observation.times[7]:.6f} (3 integrations)" in found["sentence"]
    one, two = observation.antpairs[other].tolist()
    assert f"% of antenna {observation.antenna_numbers[4]} and " in found["sentence"]
    assert f"of baseline {one}-{two}; 0 elsewhere" in found["sentence"]


def test_what_chance_scatters_is_named_nowhere(context: FitContext) -> None:
    named = 0
    for seed in range(20):
        lost = (generator(seed, "lost").random((24, context.setup.observation.Nbls)) < 0.02).astype(float)
        found = told(context, lost)
        named += len(found["times"]) + len(found["antennas"]) + len(found["baselines"])
        assert found["elsewhere"]["n"] + sum(one["n"] for one in found["times"]) <= found["n"]
    assert named <= 1
    assert "no more of any time, antenna or baseline than chance has" in found["sentence"]


def test_a_few_rows_are_named_one_by_one(context: FitContext) -> None:
    observation, lost = context.setup.observation, np.zeros((24, context.setup.observation.Nbls))
    lost[[3, 11], [2, 7]] = 1
    found = told(context, lost)
    rows = [(observation.antpairs[k].tolist(), float(observation.times[t])) for t, k in ((3, 2), (11, 7))]
    assert [(one["baseline"], one["jd"]) for one in found["elsewhere"]["rows"]] == rows
    (one, two), jd = rows[1]
    assert f" and baseline {one}-{two} at JD {jd:.6f})." in found["sentence"]


def test_nothing_is_told_where_nothing_leaves_out(context: FitContext) -> None:
    assert rows_left_out(context, Fitted()) is None


def test_chance() -> None:
    """A hundred heads of as many tosses, where the others have half; one lost where nobody knows of a rate."""
    half = np.array([100.0, 50.0, 50.0, 50.0])
    assert log_chance(half, np.full(4, 100.0))[0] == pytest.approx(100 * np.log(0.5) + np.log(4))
    assert log_chance(np.array([1.0, 0.0]), np.full(2, 100.0))[0] > np.log(0.5)
    assert np.all(log_chance(np.zeros(3), np.full(3, 100.0)) >= 0)
    assert np.all(log_chance(np.array([3.0, 0.0]), np.array([3.0, 0.0])) >= 0)


@pytest.mark.parametrize("n_bls", [21, 171, 60_000])
def test_one_integration_that_is_lost_is_named_in_arrays_of_any_size(n_bls: int) -> None:
    """Its chance is no double from a hundred baselines on; ln of it is."""
    lost, had = np.zeros(24), np.full(24, float(n_bls))
    lost[7] = n_bls
    chance = log_chance(lost, had)
    assert chance[7] == pytest.approx(-n_bls * np.log(23.0 * n_bls) + np.log(24))
    found = _most_improbable([np.array([lost, had])])
    assert found is not None
    np.testing.assert_array_equal(np.flatnonzero(found[1]), [7])
