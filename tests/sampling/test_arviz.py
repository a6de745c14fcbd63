"""Export: what ArviZ and xarray get has names for its axes, units, and survives a file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hydrabeam_mpi as hb
from hydrabeam_mpi.sampling.arviz import to_datatree
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.variable import Variable
from tests.sampling.made import IDENTITY, add, draw_of, new_store


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    store = new_store(tmp_path / "out", chains=2, draws=8, warm_up=2)
    for chain in (0, 1):
        with store.writer(chain) as writer:
            add(writer, chain, 10 - chain, 4)
    return store.folder


def test_draws_have_names_and_units(folder: Path) -> None:
    chains = hb.load_chains(folder)
    tree = chains.to_arviz()
    flux = tree["posterior"]["flux"]
    assert flux.dims == ("chain", "draw", "source")
    assert flux.attrs == {"units": "Jy", "long_name": "flux of a source", "block": "catalogue_flux"}
    np.testing.assert_array_equal(flux.sel(chain=1, draw=3, source="B"), draw_of(1, 5)["flux"][1])
    assert tree["posterior"].sizes == {"chain": 2, "draw": 7, "freq": 2, "mode": 6, "source": 3}
    np.testing.assert_array_equal(tree["posterior"]["freq"], [1.0e8, 1.1e8])
    beam = tree["posterior"]["beam_real"] + 1j * tree["posterior"]["beam_imag"]
    np.testing.assert_array_equal(beam, chains.read("beam"))
    assert tree["sample_stats"]["seconds"].attrs["units"] == "s"
    assert json.loads(tree.attrs["identity"]) == IDENTITY


def test_a_file_holds_the_same(folder: Path, tmp_path: Path) -> None:
    tree = hb.load_chains(folder).to_arviz(["flux"])
    tree.to_netcdf(tmp_path / "chains.nc")
    with xr.open_datatree(tmp_path / "chains.nc") as again:
        assert list(again["posterior"].data_vars) == ["flux"]
        xr.testing.assert_identical(again["posterior"]["flux"].load(), tree["posterior"]["flux"])


def test_blocks_are_summed_up(folder: Path) -> None:
    chains = hb.load_chains(folder)
    assert set(chains.summary()) == {"beam", "catalogue_flux", "noise"}
    assert chains.summary()["beam"]["n_parameters"] == 24
    assert chains.status().chains[1].n_draws == 9
    with pytest.raises(hb.InputError, match="no variable 'gain'; choose one of beam, flux, scale"):
        chains.read("gain")


def test_axes_of_one_name_that_differ_are_told_apart(tmp_path: Path) -> None:
    variables = [
        Variable("x", "a", (2,), ("mode",)),
        Variable("y", "b", (3,), ("mode",)),
        Variable("z", "b", (3,), ("time",), {"time": [1.0, 2.0, 3.0]}),
    ]
    store = ChainStore.create(tmp_path, {}, variables, 1, 5)
    assert to_datatree(store)["posterior"].sizes == {"chain": 0, "draw": 0, "x_mode": 2, "y_mode": 3, "time": 3}
    with store.writer(0) as writer:
        draw = {"x": np.zeros(2), "y": np.ones(3), "z": np.ones(3)}
        writer.append(draw, draw, {"seconds": 1.0})
    tree = to_datatree(store)
    assert tree["posterior"]["y"].dims == ("chain", "draw", "y_mode")
    np.testing.assert_array_equal(tree["posterior"]["time"], [1.0, 2.0, 3.0])
