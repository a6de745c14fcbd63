"""What a container or a batch system lets processes have counts, as if the machine had no more."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydrabeam_mpi import memory

LIMIT = 2**31


@pytest.fixture
def limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put this process into groups, of either version, that may have 2 GiB."""
    if not Path("/proc/self/cgroup").exists():
        pytest.skip("no groups of processes here")
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"{LIMIT}\n")
    monkeypatch.setattr(memory, "CGROUPS", tmp_path)


@pytest.mark.usefixtures("limited")
def test_limits_of_a_container_count() -> None:
    assert memory.machine_bytes() == LIMIT
    before, own = memory.free_bytes(), memory.own_bytes()
    assert before is not None
    filled = bytearray(b"\1") * 2**28
    # What is filled has been got, so that the sum stays as it is, but for what else the process does meanwhile.
    after = memory.free_bytes()
    assert after is not None
    assert abs(after - before) < 2**24
    assert memory.own_bytes() - own > 0.9 * len(filled)


@pytest.mark.usefixtures("limited")
def test_no_more_may_be_got_than_is_left_of_the_limit() -> None:
    free = memory.free_bytes()
    assert free is not None
    allocated = 1024 * int(Path("/proc/self/status").read_text().split("VmData:")[1].split()[0])
    assert free - allocated == pytest.approx(LIMIT - memory.own_bytes(), abs=2**24)
