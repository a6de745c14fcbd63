"""R-hat and effective sample sizes: those of arviz-stats, some parameters at a time, and the worst of each block."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arviz_stats.base.array import array_stats

from hydrabeam_mpi.sampling import convergence
from hydrabeam_mpi.sampling.convergence import TAIL, diagnose
from hydrabeam_mpi.sampling.storage.store import ChainStore
from tests.sampling.made import VARIABLES, add, new_store, write_values

N = 200


def autocorrelated(rho: float, n_chains: int, n: int, size: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = np.empty((n_chains, n, size))
    x[:, 0] = rng.normal(size=(n_chains, size))
    for t in range(1, n):
        x[:, t] = rho * x[:, t - 1] + np.sqrt(1 - rho**2) * rng.normal(size=(n_chains, size))
    return x


def chains_of(folder: Path, warm_up: int = 0) -> tuple[ChainStore, dict[str, np.ndarray]]:
    real, imag = autocorrelated(0.0, 3, N, 12, 1), autocorrelated(0.5, 3, N, 12, 2)
    flux = autocorrelated(0.9, 3, N, 3, 3)
    flux[2, :, 1] += 3  # one chain is elsewhere
    values = {"beam": (real + 1j * imag).reshape(3, N, 2, 6), "flux": flux, "scale": np.ones((3, N))}
    store = new_store(folder, 3, N - warm_up, warm_up)
    write_values(store, values, seconds=0.1)
    return store, values


@pytest.mark.parametrize("slice_bytes", [1, 20_000, convergence.SLICE_BYTES])
def test_numbers_are_those_of_arviz_whatever_is_read_at_a_time(
    slice_bytes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, values = chains_of(tmp_path, warm_up=20)
    monkeypatch.setattr(convergence, "SLICE_BYTES", slice_bytes)
    found = diagnose(store)
    assert (found.chains, found.n_draws) == ((0, 1, 2), N - 20)
    assert found.seconds == pytest.approx(3 * (N - 20) * 0.1)
    beam = values["beam"].reshape(3, N, 12)[:, 20:]
    axes = {"chain_axis": 0, "draw_axis": 1}
    of_beam, of_flux, of_scale = found.variables
    both = np.concatenate([beam.real, beam.imag], axis=2)
    np.testing.assert_allclose(of_beam.r_hat, array_stats.rhat(both, **axes), rtol=1e-12)
    np.testing.assert_allclose(of_beam.ess_bulk, array_stats.ess(both, **axes), rtol=1e-12)
    tail = array_stats.ess(values["flux"][:, 20:], method="tail", prob=TAIL, **axes)
    np.testing.assert_allclose(of_flux.ess_tail, tail, rtol=1e-12)
    assert np.isnan(of_scale.r_hat).all()


def test_the_worst_of_each_block_is_named(tmp_path: Path) -> None:
    store, _ = chains_of(tmp_path)
    found = diagnose(store)
    beam, flux, noise = found.blocks
    assert (beam.block, flux.block, noise.block) == ("beam", "catalogue_flux", "noise")
    assert (beam.n_parameters, flux.n_parameters, noise.n_parameters, noise.n_still) == (24, 3, 1, 1)
    assert beam.r_hat < 1.1 < flux.r_hat
    assert flux.worst == "flux[B]"
    # Of an AR(1) process n draws are worth n (1 - rho) / (1 + rho).
    assert 3 * N / 3 * 0.5 < beam.ess_bulk < 3 * N / 3 * 2
    assert beam.ess_per_second == min(beam.ess_bulk, beam.ess_tail) / found.seconds
    *_, second, third = found.warnings()
    assert second.startswith("block catalogue_flux has not converged: R-hat of flux[B] is ")
    assert second.endswith(", above 1.01; draw more")
    assert third == "block noise: 1 of 1 parameters never move"


def test_chains_that_stand_still_at_different_places_have_not_converged(tmp_path: Path) -> None:
    _, values = chains_of(tmp_path / "a")
    values["scale"] = np.repeat(np.arange(3.0)[:, None], N, axis=1)
    other = new_store(tmp_path / "b", 3, N)
    write_values(other, values, seconds=0.1)
    assert diagnose(other).blocks[2].r_hat > 1e3
    assert "block noise has not converged" in diagnose(other).warnings()[-1]


def test_short_chains_are_left_out_and_few_draws_say_nothing(tmp_path: Path) -> None:
    store = new_store(tmp_path, chains=3, draws=50)
    assert diagnose(store).blocks[0].n_parameters == 24
    for chain, n in enumerate((30, 20, 9)):
        with store.writer(chain) as writer:
            add(writer, chain, n, 100)
        found = diagnose(store)
    assert (found.chains, found.n_draws) == ((0, 1), 20)
    short = new_store(tmp_path / "short")
    with short.writer(0) as writer:
        add(writer, 0, 3, 100)
    found = diagnose(short)
    assert np.isnan([block.r_hat for block in found.blocks]).all()
    assert found.warnings() == []
    assert len(found.variables) == len(VARIABLES)


def test_of_a_single_chain_the_halves_are_compared(tmp_path: Path) -> None:
    """One flux drifts."""
    flux = autocorrelated(0.0, 1, N, 3, 5)
    flux[0, :, 2] += np.linspace(0, 3, N)
    beam = autocorrelated(0.0, 1, N, 12, 6).reshape(1, N, 2, 6)
    store = new_store(tmp_path / "long", 1, N)
    write_values(store, {"beam": beam + 1j * beam, "flux": flux, "scale": flux[..., 0]}, seconds=0.1)
    of_beam, of_flux, _ = diagnose(store).blocks
    assert of_beam.r_hat < 1.1 < 1.3 < of_flux.r_hat < 3
    assert of_flux.worst == "flux[C]"
    short = new_store(tmp_path / "short")
    with short.writer(0) as writer:
        add(writer, 0, 7, 100)
    assert diagnose(short).warnings() == []
