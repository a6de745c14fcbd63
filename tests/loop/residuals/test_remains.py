"""Whether what is left of the held-out data may be noise, or noise of another level."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import ComplexArray
from hydrabeam_mpi.effects.noise.noise_level import NoiseLevel
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.heldout import Whitened, whiten
from hydrabeam_mpi.fit.state import Fitted, Reweighted, Values
from hydrabeam_mpi.loop.residuals.remains import remains_of
from hydrabeam_mpi.random import complex_normal, generator
from tests.loop.mock import FREQ, context_of, mock_job

N_TIMES = 24


@pytest.fixture(scope="module")
def context(comm: MPI.Comm, tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    """Two channels of a small array, on all ranks."""
    job = mock_job(freqs=(FREQ, FREQ + 8e6), n_times=N_TIMES)
    return context_of(job, comm.bcast(tmp_path_factory.mktemp("remains")), comm)


@pytest.fixture(scope="module")
def fitted(context: FitContext) -> Fitted:
    return refit(context, Values())


def with_residuals(context: FitContext, whitened: Whitened, z: ComplexArray) -> Whitened:
    """Put this rank's rows of residuals, (2, Ntimes, Nbls) of all, in the place of the whitened ones."""
    tile = context.test.rows.tile
    return replace(whitened, z=z[np.ix_(context.channels, tile.times, tile.bls)])


def white(context: FitContext) -> ComplexArray:
    n_bls = context.setup.observation.Nbls
    return np.sqrt(2) * complex_normal(generator(3, "remains"), (2, N_TIMES, n_bls))


def noisy_antenna(context: FitContext) -> ComplexArray:
    """As much as fitted and held-out rows may disagree on."""
    return white(context) * np.where(np.any(context.setup.antenna_index == 3, axis=1), 1.5, 1.0)


def loud_time(context: FitContext) -> ComplexArray:
    return white(context) * np.where(np.arange(N_TIMES) == context.problem.test.times[3], 3.0, 1.0)[:, np.newaxis]


def constant(context: FitContext) -> ComplexArray:
    return white(context) + 4.0 * (np.arange(context.setup.observation.Nbls) == 5)


# Scales that change nothing: what counts is which there are.
ONE, EACH = (Reweighted(NoiseLevel(), np.ones((2, n)), np.zeros((2, n))) for n in (1, 8))
NO_STRUCTURE = "it has no structure beyond chance"
LEFT: dict[str, tuple[Callable[[FitContext], ComplexArray], list[Reweighted], bool, bool, str]] = {
    "noise is consistent": (white, [], True, True, NO_STRUCTURE),
    "louder noise is white": (lambda context: 1.5 * white(context), [], False, True, NO_STRUCTURE),
    "quieter noise is no excess": (lambda context: 0.7 * white(context), [], True, True, NO_STRUCTURE),
    "a noisy antenna is not white": (noisy_antenna, [], False, False, "sigma)"),
    "nor is it with one scale for all": (noisy_antenna, [ONE], False, False, "sigma)"),
    "it is where antennas have scales": (noisy_antenna, [EACH], False, True, NO_STRUCTURE),
    "a constant of one baseline is not white": (constant, [EACH], False, False, "sigma)"),
    "a loud time is not white": (loud_time, [EACH], False, False, "it is uneven over times"),
}


@pytest.mark.mpi
@pytest.mark.parametrize(("residuals", "reweighted", "consistent", "is_white", "why"), LEFT.values(), ids=LEFT)
def test_what_is_left(
    residuals: Callable[[FitContext], ComplexArray],
    reweighted: list[Reweighted],
    consistent: bool,
    is_white: bool,
    why: str,
    context: FitContext,
    fitted: Fitted,
) -> None:
    """On any number of ranks."""
    whitened = with_residuals(context, whiten(context, fitted), residuals(context))
    found = remains_of(context, replace(fitted, values=Values(reweighted=tuple(reweighted))), whitened)
    assert (found.consistent, found.white) == (consistent, is_white)
    assert why in found.why
    assert found.consistent == (found.statistics["significance"]["p"] >= 1e-3)
    assert found.where["sentence"]
    assert found.structures is not None


@pytest.mark.mpi
@pytest.mark.parametrize(("scale", "told"), [(0.8, "unevenness, antennas ("), (1.5, "")], ids=["one antenna", "all"])
def test_what_stands_out_is_told_where_all_of_it_does_not(
    scale: float, told: str, context: FitContext, fitted: Fitted
) -> None:
    """On any number of ranks."""
    z = scale * noisy_antenna(context)
    found = remains_of(context, fitted, with_residuals(context, whiten(context, fitted), z))
    assert not found.consistent
    assert found.stands_out.startswith(told)
    assert bool(found.stands_out) == bool(told)


@pytest.mark.mpi
def test_bad_integrations_are_named_among_fitted_and_held_out_rows(context: FitContext, fitted: Fitted) -> None:
    """On any number of ranks, each alone."""
    train, test = context.train, context.problem.test.times[5]
    rows, bad = train.rows, context.problem.train.times[7]
    sigma = np.divide(1.0, np.sqrt(rows.inv_noise_var), where=rows.inv_noise_var > 0, out=np.zeros(rows.data.shape))
    shape = (2, context.setup.observation.Ntimes, context.setup.observation.Nbls)
    local = np.ix_(context.channels, rows.tile.times, rows.tile.bls)
    burst = 30 * sigma * complex_normal(generator(4, "burst"), shape)[local]
    data = rows.data + np.where((rows.tile.times == bad)[:, np.newaxis], burst, 0.0)
    hit = replace(context, train=replace(train, rows=replace(rows, data=data)))
    z = white(context) * np.where(np.arange(N_TIMES) == test, 30.0, 1.0)[:, np.newaxis]
    odd = remains_of(hit, fitted, with_residuals(context, whiten(context, fitted), z)).odd
    assert [one.what for one in odd] == ["an integration that stands out"] * 2
    told = {one.where: one.why for one in odd}
    times = context.setup.observation.times
    assert "fitted (" in told[f"JD {times[bad]:.6f}"]
    assert "held out (" in told[f"JD {times[test]:.6f}"]
    assert remains_of(context, fitted, with_residuals(context, whiten(context, fitted), white(context))).odd == ()
