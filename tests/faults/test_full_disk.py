"""Results that go to a disk too small for them; `tools/fuzz --full-disk` has every command and many sizes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.full_disk import FullDisks, can_mount
from tests.faults.oracle import CLEAN


@pytest.mark.skipif(not can_mount(), reason="no file system may be mounted here")
def test_a_full_disk_ends_in_one_line(samples: Path) -> None:
    disks = FullDisks(samples)
    for index in (0, 1, 9):
        title, kind, words = disks.run(8, index)
        assert kind == CLEAN, f"{title}: {words}"
