"""Chains that are made without a model: their draws are known by number."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.variable import Variable
from hydrabeam_mpi.sampling.storage.writer import ChainWriter

IDENTITY = {"job": "abc", "data": {"a.uvh5": "123"}, "basis": {"kind": "fourier_bessel", "n_modes": 6}, "seed": 1}
VARIABLES = (
    Variable("beam", "beam", (2, 6), ("freq", "mode"), {"freq": [1.0e8, 1.1e8]}, "", "coefficients", "complex128"),
    Variable("flux", "catalogue_flux", (3,), ("source",), {"source": ["A", "B", "C"]}, "Jy", "flux of a source"),
    Variable("scale", "noise", unit="1", long_name="noise over what is stated"),
)


def new_store(folder: Path, chains: int = 1, draws: int = 100, warm_up: int = 0) -> ChainStore:
    return ChainStore.create(folder, IDENTITY, VARIABLES, chains, draws, warm_up, {"versions": {"numpy": "2"}})


def draw_of(chain: int, number: int) -> dict[str, Array]:
    rng = np.random.default_rng([chain, number])
    return {
        "beam": rng.normal(size=(2, 6)) + 1j * rng.normal(size=(2, 6)),
        "flux": rng.normal(10, 1, size=3),
        "scale": np.array(number),
    }


def add(writer: ChainWriter, chain: int, n: int, at_once: int = 1) -> None:
    """Append draws, ``at_once`` of them a segment."""
    for _ in range(n):
        number = writer.n_draws
        draw = draw_of(chain, number)
        writer.append(draw, {**draw, "widths": np.full(2, number)}, {"seconds": 0.5, "log_posterior": -float(number)})
        if writer.n_draws % at_once == 0:
            writer.flush()


def check_draws(store: ChainStore, chain: int, n: int) -> None:
    """Make sure that a chain has the first n draws, and the state after them."""
    assert store.n_draws(chain) == n
    number, state = store.last(chain)
    assert number == n
    if n:
        np.testing.assert_array_equal(state["widths"], [n - 1, n - 1])
        np.testing.assert_array_equal(state["flux"], draw_of(chain, n - 1)["flux"])
    for name in ("beam", "flux", "scale"):
        expected = [draw_of(chain, number)[name] for number in range(n)]
        np.testing.assert_array_equal(
            store.read(name, chain, slice(None)), np.reshape(expected, (n, *store.variable(name).shape))
        )
    np.testing.assert_array_equal(store.info("log_posterior", chain, slice(None)), -np.arange(float(n)))


def write_values(store: ChainStore, values: Mapping[str, Array], seconds: float) -> None:
    """Write draws, (n_chains, n_draws, ...) of every variable."""
    for chain in range(store.chains):
        with store.writer(chain) as writer:
            for number in range(store.total):
                draw = {name: array[chain, number] for name, array in values.items()}
                writer.append(draw, draw, {"seconds": seconds})
