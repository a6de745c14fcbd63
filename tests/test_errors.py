from __future__ import annotations

import pickle

import pytest

from hydrabeam_mpi.errors import InputError


@pytest.mark.parametrize(
    ("details", "line"),
    [
        ({}, "is wrong"),
        ({"file": "a.uvh5"}, "a.uvh5: is wrong"),
        ({"field": "freq"}, "freq: is wrong"),
        ({"remedy": "mend it"}, "is wrong; mend it"),
        ({"file": "a.uvh5", "field": "freq", "remedy": "mend it"}, "a.uvh5: freq: is wrong; mend it"),
    ],
)
def test_one_line(details: dict[str, str], line: str) -> None:
    assert str(InputError("is wrong", **details)) == line


def test_whatever_a_library_says_is_one_line() -> None:
    error = InputError("cannot be read (two\nlines\n\n  of it)", file="a.uvh5", remedy="mend\nit")
    assert str(error) == "a.uvh5: cannot be read (two lines of it); mend it"


def test_what_is_as_long_as_a_file_is_cut() -> None:
    assert str(InputError("no number: " + "9" * 10**6, file="a.txt")) == f"a.txt: no number: {'9' * 489} ..."


def test_what_a_terminal_would_obey_shows_as_escapes() -> None:
    name = "Ant\x1b[2J\x00 'größer' 面 \u202e\udcff"
    assert str(InputError("no such file", file=name)) == ("Ant\\x1b[2J\\x00 'größer' 面 \\u202e\\udcff: no such file")


def test_locate_names_a_file_once() -> None:
    error = InputError("is wrong", field="[data] files", remedy="mend it")
    error.locate("job.toml")
    assert str(error) == "job.toml: [data] files: is wrong; mend it"
    error.locate("another.toml")
    assert error.file == "job.toml"
    assert str(error) == "job.toml: [data] files: is wrong; mend it"


def test_survives_the_way_to_another_rank() -> None:
    error = InputError("is wrong", field="freq", remedy="mend it")
    error.locate("job.toml")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert (copy.message, copy.file, copy.field, copy.remedy) == ("is wrong", "job.toml", "freq", "mend it")
