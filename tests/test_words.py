"""Times, sizes and tables in words."""

from __future__ import annotations

import pytest

from hydrabeam_mpi.words import duration, megahertz_of, size, text_table


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        *((-1.0, "0 s"), (0.0, "0 s"), (2e-6, "0 s"), (0.34, "0.34 s"), (8.34, "8.3 s"), (59.2, "59 s")),
        *(
            (60, "1 min"),
            (61.7, "1 min 1 s"),
            (3660, "1 h 1 min"),
            (3630, "1 h"),
            (90000, "1 d 1 h"),
            (86399, "23 h 59 min"),
        ),
    ],
)
def test_durations_as_people_say_them(seconds: float, words: str) -> None:
    assert duration(seconds) == words


@pytest.mark.parametrize(
    ("n_bytes", "words"),
    [(0, "0 B"), (999, "999 B"), (1000, "1 kB"), (999_600, "1 MB"), (656.4e6, "656 MB"), (3.2e13, "32 TB")],
)
def test_sizes_have_three_digits(n_bytes: float, words: str) -> None:
    assert size(n_bytes) == words


def test_columns_are_aligned() -> None:
    assert text_table([("a", "b", "c"), ("long", "10", "")], right=[1]) == "a      b  c\nlong  10"


def test_frequencies_are_listed_in_megahertz() -> None:
    assert megahertz_of([131e6, 151.1953125e6]) == "131, 151.195"
    assert megahertz_of(iter([])) == ""
