"""What a user sees of chains that run."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydrabeam_mpi.commands.sample_status import print_status
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.sampling.status import number, status_of
from hydrabeam_mpi.sampling.storage.store import ChainStore
from tests.sampling.made import add, draw_of, new_store


def test_progress_is_told_while_a_chain_grows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = new_store(tmp_path, chains=3, draws=30, warm_up=5)
    assert "0 of 35" in str(status_of(store))
    with store.writer(0) as one, store.writer(1) as other:
        for number in range(25):
            at = {"seconds": 0.5, "time": 1e9 + 0.5 * number}
            one.append(draw_of(0, number), {}, at)
            if number < 15:
                other.append(draw_of(1, number), {}, {**at, "time": at["time"] + 5})
        one.flush()
        other.flush()
        found = status_of(ChainStore.open(tmp_path))
        assert [chain.n_draws for chain in found.chains] == [25, 15, 0]
        # 40 draws in 12.5 s; the third chain comes after the others.
        assert found.seconds_left == pytest.approx((10 + 20 + 35) * 12.5 / 40)
        print_status(tmp_path)
    said = capsys.readouterr().out
    for words in ("25 of 35", "The first 5 draws of each chain are its warm-up", "time left: 20 s", "catalogue_flux"):
        assert words in said
    assert "R-hat of scale is" in said.splitlines()[-1]


def test_the_end_and_damage_are_told(tmp_path: Path) -> None:
    store = new_store(tmp_path, draws=10)
    with store.writer(0) as writer:
        add(writer, 0, 10, 5)
    assert "all draws are there" in str(status_of(store))
    path = tmp_path / "chain-0" / "00000005-00000009.h5"
    path.write_bytes(path.read_bytes()[:-100])
    (line, *_) = status_of(store).cautions
    assert line == f"{path}: is truncated or damaged: of chain 0 the first 9 draws are kept, which are whole"


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"chains\.json: no such file"):
        print_status(tmp_path)


def test_numbers_and_times_in_words() -> None:
    assert [number(value) for value in (0.012345, 12.345, 12345.6, float("nan"), float("inf"))] == [
        "0.0123",
        "12.3",
        "12346",
        "-",
        "-",
    ]
