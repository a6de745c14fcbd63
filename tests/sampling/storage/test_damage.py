"""Damaged chain files and full disks: what is whole stays, and a line says how much that is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.sampling.storage.store import ChainStore
from tests.sampling.made import add, check_draws, new_store

AT_ONCE = 4
SEGMENTS = 5


def written(folder: Path) -> ChainStore:
    store = new_store(folder)
    with store.writer(0) as writer:
        add(writer, 0, AT_ONCE * SEGMENTS, AT_ONCE)
    return store


@pytest.mark.parametrize("kind", ["truncated", "flipped", "overwritten", "gone"])
@pytest.mark.parametrize("seed", range(6))
def test_whole_draws_before_the_damage_are_kept(
    kind: str, seed: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rng = np.random.default_rng(seed)
    written(tmp_path)
    number = int(rng.integers(SEGMENTS))
    path = sorted((tmp_path / "chain-0").glob("*.h5"))[number]
    content = bytearray(path.read_bytes())
    at = int(rng.integers(len(content)))
    if kind == "truncated":
        path.write_bytes(content[:at])
    elif kind == "flipped":
        content[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
    elif kind == "overwritten":
        content[at : at + 100] = rng.bytes(len(content[at : at + 100]))
        path.write_bytes(content)
    else:
        path.unlink()
    store = ChainStore.open(tmp_path)
    n = store.n_draws(0)
    # All are there where nothing is damaged but room between them.
    assert n == AT_ONCE * SEGMENTS or AT_ONCE * number <= n < AT_ONCE * (number + 1)
    check_draws(store, 0, n)
    lost = n < AT_ONCE * SEGMENTS and not (kind == "gone" and number == SEGMENTS - 1)
    told = [f"of chain 0 the first {n} draws are kept, which are whole"] * lost
    assert [line.split(": ")[-1] for line in store.cautions()] == told
    with store.writer(0) as writer:
        assert writer.n_draws == n
        assert [record.getMessage().split("; ")[0].split(": ")[-1] for record in caplog.records] == told
        check_draws(store, 0, n)
        add(writer, 0, AT_ONCE * SEGMENTS - n)
    assert store.cautions() == []
    check_draws(store, 0, AT_ONCE * SEGMENTS)


@pytest.mark.parametrize("kind", ["truncated", "overwritten"])
def test_draws_before_the_damage_are_kept_of_a_file_too(kind: str, tmp_path: Path) -> None:
    """All but those that are beside it: a sixteenth of the file's."""
    n, rng = 128, np.random.default_rng(1)
    with new_store(tmp_path).writer(0) as writer:
        add(writer, 0, n, n)
    (path,) = (tmp_path / "chain-0").glob("*.h5")
    content = path.read_bytes()
    about = content.index(b"checksums") + 20_000  # what describes the data is before them
    kept = []
    for at in rng.integers(about, len(content), 20):
        path.write_bytes(content[:at] + (b"" if kind == "truncated" else rng.bytes(50) + content[at + 50 :]))
        store = ChainStore.open(tmp_path)
        kept.append(store.n_draws(0))
        check_draws(store, 0, kept[-1])
        whole = n * (at - about) // (len(content) - about)
        assert whole - n // 16 <= kept[-1] <= n
    assert len({*kept}) > 5


def test_a_damaged_file_that_was_merged_from_others_falls_back_to_them(tmp_path: Path) -> None:
    """As a kill between the merge and the removal of what was merged leaves it, and damage after that."""
    store = written(tmp_path)
    (tmp_path / "chain-0" / "00000000-00000007.h5").write_bytes(b"damaged")
    check_draws(store, 0, AT_ONCE * SEGMENTS)
    store.writer(0).close()
    assert len(list((tmp_path / "chain-0").glob("*.h5"))) == SEGMENTS


def test_a_full_disk_leaves_what_is_whole(small_disk: Path) -> None:
    store = new_store(small_disk / "out", draws=10**5)
    with pytest.raises(InputError) as caught, store.writer(0) as writer:
        add(writer, 0, 10**5, 10)
    n = store.n_draws(0)
    assert str(caught.value) == (
        f"{small_disk / 'out'}: -o: cannot be written (No space left on device): the first {n} draws of chain 0 are "
        "kept; make room, and run the same command again to go on"
    )
    assert n > 10
    check_draws(ChainStore.open(small_disk / "out"), 0, n)
    assert not list((small_disk / "out" / "chain-0").glob(".*partial*"))


def test_files_may_not_be_larger(tmp_path: Path) -> None:
    """The same where the system bounds what a process may write."""
    new_store(tmp_path, draws=10**5)
    ended = subprocess.run(
        [
            sys.executable,
            "-c",
            f"""
import resource, signal
from pathlib import Path
from tests.sampling.made import *
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
writer = ChainStore.open(Path({str(tmp_path)!r})).writer(0)
add(writer, 0, 20, 20)
try:
    add(writer, 0, 500, 10**5)
    writer.flush()
except Exception as error:
    print(type(error).__name__, error, sep=": ")
""",
        ],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[3],
    )
    assert ended.stdout.startswith(
        f"InputError: {tmp_path}: -o: cannot be written (File too large): the first 20 draws"
    )
    check_draws(ChainStore.open(tmp_path), 0, 20)
