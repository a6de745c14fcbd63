"""Folders of chains: what is written is read again, by slices, and belongs to one job."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.sampling.storage import writer as writer_module
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.variable import Variable
from hydrabeam_mpi.sampling.storage.writer import MOST_SMALL, SMALL_DRAWS
from tests.sampling.made import IDENTITY, VARIABLES, add, check_draws, draw_of, new_store


def test_draws_are_read_as_they_were_written(tmp_path: Path) -> None:
    new_store(tmp_path / "out", chains=2, draws=20, warm_up=5)
    for chain in (0, 1):
        with ChainStore.open(tmp_path / "out", IDENTITY).writer(chain) as writer:
            add(writer, chain, 17, at_once=5)
    store = ChainStore.open(tmp_path / "out")
    assert (store.variables, store.total, store.about) == (VARIABLES, 25, {"versions": {"numpy": "2"}})
    assert store.cautions() == []
    for chain in (0, 1):
        check_draws(store, chain, 17)
    assert len(store.read("flux", 0)) == len(store.info("seconds", 0)) == 12
    np.testing.assert_array_equal(
        store.read("beam", 1, slice(3, 12), slice(7, 9)),
        [draw_of(1, number)["beam"].ravel()[7:9] for number in range(3, 12)],
    )
    assert store.read("beam", 1, slice(17, None)).shape == (0, 2, 6)
    assert store.read("beam", 1, slice(17, None), slice(0, 4)).shape == (0, 4)


def test_before_the_first_draw(tmp_path: Path) -> None:
    store = new_store(tmp_path)
    check_draws(store, 0, 0)
    assert (store.last(0), store.cautions()) == ((0, {}), [])


def test_files_tell_what_is_in_them(tmp_path: Path) -> None:
    with new_store(tmp_path).writer(0) as writer:
        add(writer, 0, 3, at_once=3)
    with h5py.File(tmp_path / "chain-0" / "00000000-00000002.h5", "r") as file:
        assert dict(file.attrs) == {"format": 1, "chain": 0, "first_draw": 0, "n_draws": 3}
        about = file["draws/flux"].attrs
        told = [about[name].decode() for name in ("units", "long_name", "block", "dims")]
        assert told == ["Jy", "flux of a source", "catalogue_flux", "source"]


def test_a_chain_goes_on_where_it_ended(tmp_path: Path) -> None:
    store = new_store(tmp_path)
    for n in (4, 1, 7):
        with store.writer(0) as writer:
            add(writer, 0, n, at_once=100)
    check_draws(ChainStore.open(tmp_path), 0, 12)
    store.extend(3, 1000)
    again = ChainStore.open(tmp_path, IDENTITY)
    assert (again.chains, again.draws) == (3, 1000)


def test_one_process_writes_a_chain(tmp_path: Path) -> None:
    store = new_store(tmp_path, chains=2)
    with store.writer(0), store.writer(1), pytest.raises(InputError, match="chain-0: is being written by another run"):
        store.writer(0)
    store.writer(0).close()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 2}, "seed: is 1 in the chains, and 2 in the job; name another folder"),
        ({"data": {"a.uvh5": "124"}}, 'data a.uvh5: is "123" in the chains, and "124" in the job'),
        ({"basis": {"kind": "zernike", "n_modes": 6}}, 'basis kind: is "fourier_bessel" in the chains'),
        ({"blocks": ["beam"]}, 'blocks: is missing in the chains, and ["beam"] in the job'),
    ],
)
def test_chains_of_another_job_are_refused(change: dict[str, object], told: str, tmp_path: Path) -> None:
    new_store(tmp_path)
    with pytest.raises(InputError) as caught:
        ChainStore.open(tmp_path, {**IDENTITY, **change})
    assert str(caught.value).startswith(f"{tmp_path / 'chains.json'}: {told}")


def test_folders_without_chains_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"chains\.json: no such file; name a folder that 'hydrabeam sample' wrote"):
        ChainStore.open(tmp_path)
    new_store(tmp_path)
    with pytest.raises(InputError, match="has chains already"):
        new_store(tmp_path)
    path = tmp_path / "chains.json"
    table = json.loads(path.read_text())
    for key, value in (("format", 0), ("variables", [{"name": "x"}]), ("chains", "many")):
        path.write_text(json.dumps({**table, key: value}))
        with pytest.raises(InputError, match=r"chains\.json"):
            ChainStore.open(tmp_path)
    path.write_text(path.read_text()[:-40])
    with pytest.raises(InputError, match=r"chains\.json: cannot be read as a description of chains"):
        ChainStore.open(tmp_path)


def test_draws_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    with new_store(tmp_path).writer(0) as writer:
        add(writer, 0, 2)
        bad = {**draw_of(0, 2), "flux": np.array([1.0, np.nan, 1.0])}
        with pytest.raises(InputError, match="chain 0, draw 2: flux: 1 of 3 numbers are not finite"):
            writer.append(bad, {}, {"seconds": 1.0})
    check_draws(ChainStore.open(tmp_path), 0, 2)


def test_many_draws_make_few_files(tmp_path: Path) -> None:
    n, at_once = 2000, 40
    store = new_store(tmp_path)
    with store.writer(0) as writer:
        add(writer, 0, n, at_once)
    files = list((tmp_path / "chain-0").glob("*.h5"))
    assert len(files) < n / SMALL_DRAWS + MOST_SMALL
    check_draws(store, 0, n)


def test_one_parameter_is_read_without_the_others(tmp_path: Path) -> None:
    """A tenth of what the file takes may be read for one of 2000 parameters."""
    variable = Variable("x", "beam", (2000,), ("mode",))
    store = ChainStore.create(tmp_path, {}, [variable], 1, 500)
    with store.writer(0) as writer:
        for number in range(500):
            writer.append({"x": np.full(2000, float(number))}, {}, {"seconds": 1.0})
    store.n_draws(0)  # checks the files
    before = _bytes_read()
    np.testing.assert_array_equal(store.read("x", 0, index=slice(7, 8))[:, 0], np.arange(500.0))
    assert _bytes_read() - before < 0.1 * 500 * 2000 * 8


def _bytes_read() -> int:
    lines = Path("/proc/self/io").read_text().splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("rchar")))


def test_killed_at_any_moment_every_whole_draw_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process writes a file a draw, merges every fourth, is read meanwhile, killed and started again, 25 times."""
    monkeypatch.setattr(writer_module, "MOST_SMALL", 4)
    store = new_store(tmp_path, draws=10**6)
    rng = np.random.default_rng(5)
    n = 0
    for _ in range(25):
        receiver, sender = os.pipe()
        writing = os.fork()
        if writing == 0:
            os.close(receiver)
            _write_until_killed(tmp_path, sender)
        os.close(sender)
        with os.fdopen(receiver, "rb") as told:
            lines = [told.readline() for _ in range(rng.integers(2, 7))]
            seen = store.read("scale", 0)
            np.testing.assert_array_equal(seen, np.arange(len(seen)))
            time.sleep(rng.uniform(0, 0.02))
            os.kill(writing, signal.SIGKILL)
            os.waitpid(writing, 0)
            lines += told.readlines()
        assert store.n_draws(0) >= max(n + 1, int(lines[-1]))
        n = store.n_draws(0)
        assert store.cautions() == []
        check_draws(ChainStore.open(tmp_path), 0, n)
    store.writer(0).close()
    assert not list((tmp_path / "chain-0").glob(".*partial*"))
    assert len(list((tmp_path / "chain-0").glob("*.h5"))) < 4


def _write_until_killed(folder: Path, sender: int) -> None:
    try:
        with ChainStore.open(folder).writer(0) as writer:
            os.write(sender, b"begun\n")
            while True:
                add(writer, 0, 1)
                os.write(sender, b"%d\n" % writer.n_draws)
    finally:
        os._exit(1)
