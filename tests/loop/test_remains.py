"""Whether what is left of the held-out data may be noise, or noise of another level."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import ComplexArray
from hydrabeam_mpi.effects.noise_level import NoiseLevel
from hydrabeam_mpi.loop.heldout import Whitened, whiten
from hydrabeam_mpi.loop.refit import Space, refit
from hydrabeam_mpi.loop.remains import remains_of
from hydrabeam_mpi.loop.state import Reweighted, State
from hydrabeam_mpi.random import complex_normal, generator
from tests.loop.mock import FREQ, mock_job, space_of

N_TIMES = 24


@pytest.fixture(scope="module")
def space(comm: MPI.Comm, tmp_path_factory: pytest.TempPathFactory) -> Space:
    """Two channels of a small array, on all ranks."""
    job = mock_job(freqs=(FREQ, FREQ + 8e6), n_times=N_TIMES)
    return space_of(job, comm.bcast(tmp_path_factory.mktemp("remains")), comm)


@pytest.fixture(scope="module")
def state(space: Space) -> State:
    return refit(space, State())


def with_residuals(space: Space, whitened: Whitened, z: ComplexArray) -> Whitened:
    """Put this rank's rows of residuals, (2, Ntimes, Nbls) of all, in the place of the whitened ones."""
    tile = space.test.rows.tile
    return replace(whitened, z=z[np.ix_(space.channels, tile.times, tile.bls)])


def white(space: Space) -> ComplexArray:
    n_bls = space.experiment.observation.Nbls
    return np.sqrt(2) * complex_normal(generator(3, "remains"), (2, N_TIMES, n_bls))


def noisy_antenna(space: Space) -> ComplexArray:
    """As much as fitted and held-out rows may disagree on."""
    return white(space) * np.where(np.any(space.experiment.antenna_index == 3, axis=1), 1.5, 1.0)


def loud_time(space: Space) -> ComplexArray:
    return white(space) * np.where(np.arange(N_TIMES) == space.problem.test.times[3], 3.0, 1.0)[:, np.newaxis]


def constant(space: Space) -> ComplexArray:
    return white(space) + 4.0 * (np.arange(space.experiment.observation.Nbls) == 5)


# Scales that change nothing: what counts is which there are.
ONE, EACH = (Reweighted(NoiseLevel(), np.ones((2, n)), np.zeros((2, n))) for n in (1, 8))
NO_STRUCTURE = "it has no structure beyond chance"
LEFT: dict[str, tuple[Callable[[Space], ComplexArray], list[Reweighted], bool, bool, str]] = {
    "noise is consistent": (white, [], True, True, NO_STRUCTURE),
    "louder noise is white": (lambda space: 1.5 * white(space), [], False, True, NO_STRUCTURE),
    "quieter noise is no excess": (lambda space: 0.7 * white(space), [], True, True, NO_STRUCTURE),
    "a noisy antenna is not white": (noisy_antenna, [], False, False, "sigma)"),
    "nor is it with one scale for all": (noisy_antenna, [ONE], False, False, "sigma)"),
    "it is where antennas have scales": (noisy_antenna, [EACH], False, True, NO_STRUCTURE),
    "a constant of one baseline is not white": (constant, [EACH], False, False, "sigma)"),
    "a loud time is not white": (loud_time, [EACH], False, False, "it is uneven over times"),
}


@pytest.mark.mpi
@pytest.mark.parametrize(("residuals", "reweighted", "consistent", "is_white", "why"), LEFT.values(), ids=LEFT)
def test_what_is_left(
    residuals: Callable[[Space], ComplexArray],
    reweighted: list[Reweighted],
    consistent: bool,
    is_white: bool,
    why: str,
    space: Space,
    state: State,
) -> None:
    """On any number of ranks."""
    whitened = with_residuals(space, whiten(space, state), residuals(space))
    found = remains_of(space, replace(state, reweighted=reweighted), whitened)
    assert (found.consistent, found.white) == (consistent, is_white)
    assert why in found.why
    assert found.consistent == (found.statistics["significance"]["p"] >= 1e-3)
    assert found.where["sentence"]
    assert found.structures is not None
