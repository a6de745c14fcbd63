from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.config.frequency import OverFrequency
from hydrabeam_mpi.fit.coupled import MOST_REFINED, refined, top_of_parabola
from hydrabeam_mpi.inference.coupled import ChannelTold, CoupledEquations
from hydrabeam_mpi.inference.over_frequency import KERNELS
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.setup.over_frequency import N_LENGTHS, couple

FREQS = 130e6 + 0.4e6 * np.arange(16)
N_MODES = 60


@pytest.mark.parametrize("length", [0.7e6, 2e6, 4.1e6])
def test_the_length_is_the_likeliest_and_not_that_of_a_grid(length: float) -> None:
    """Of beams that are drawn with that length, to a tenth of their widths."""
    rng = generator(3, "lengths", int(length))
    covariance = KERNELS["matern-5/2"](FREQS, length)
    beams = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(FREQS))) @ rng.standard_normal((len(FREQS), N_MODES))
    information = 100.0
    noise = np.sqrt(information) * rng.standard_normal(beams.shape)
    scores = information * beams + noise
    told = [ChannelTold(information * np.eye(N_MODES), score) for score in scores]

    def evidence_of(modes: np.ndarray) -> float:
        equations = CoupledEquations(modes, N_MODES, False, 0)
        for channel, one in enumerate(told):
            equations.add(channel, one, None)
        return float(equations.solve().joint.log_evidence)

    first = couple(OverFrequency(kind="gaussian-process", kernel="matern-5/2"), FREQS)
    assert first is not None
    assert first.may_refine
    evidences = np.array(list(map(evidence_of, first.candidates)))
    assert evidences.shape == (N_LENGTHS,)
    coupling, of_all = refined(first, evidences, evidence_of)
    assert list(coupling.lengths) == sorted(coupling.lengths)
    assert N_LENGTHS < len(coupling.lengths) <= N_LENGTHS + MOST_REFINED
    assert [evidence_of(modes) for modes in coupling.candidates] == of_all.tolist()
    # No other length, in steps of 3%, has a nat more.
    best = coupling.lengths[int(np.argmax(of_all))]
    for near in best * np.geomspace(0.6, 1.6, 33):
        other, place = coupling.with_length(near)
        assert evidence_of(other.candidates[place]) < of_all.max() + 1


def test_lengths_that_a_job_gives_are_as_it_gives_them() -> None:
    given = couple(OverFrequency(kind="gaussian-process", length=[1e6, 2e6, 4e6]), FREQS)
    averaged = couple(OverFrequency(kind="gaussian-process", evidence="marginalise"), FREQS)
    assert given is not None
    assert averaged is not None
    assert not given.may_refine
    assert not averaged.may_refine


def test_the_top_of_a_parabola_is_where_it_is() -> None:
    x = np.array([-0.4, 0.1, 0.7])
    top, above = top_of_parabola(x, 5.0 - 3.0 * (x - 0.2) ** 2)
    assert (top, above) == (pytest.approx(0.2), pytest.approx(0.03))
    assert top_of_parabola(x, np.ones(3)) == (0.1, 0.0)
