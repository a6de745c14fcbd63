from __future__ import annotations

import pytest

from hydrabeam_mpi.loop.attribution.columns_that_matter import shared_out


@pytest.mark.parametrize(
    ("wanted", "room", "shares"),
    [
        ([], 10, []),
        ([3, 4], 10, [3, 4]),
        ([5, 100, 7], 60, [5, 48, 7]),
        ([100, 2, 100, 8], 60, [25, 2, 25, 8]),
        ([100, 100, 100], 60, [20, 20, 20]),
        ([0, 1, 1, 1], 2, [0, 0, 1, 1]),
    ],
)
def test_what_some_do_not_need_the_others_share(wanted: list[int], room: int, shares: list[int]) -> None:
    assert shared_out(wanted, room) == shares
