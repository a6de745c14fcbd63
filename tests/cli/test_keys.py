"""What a job file may say, as the command line tells it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator

import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import Job, Section
from hydrabeam_mpi.config.text import tables_of


def told(capfd: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["keys", *arguments]) == 0
    return capfd.readouterr().out


def sections(section: type[Section] = Job) -> Iterator[type[Section]]:
    yield section
    for table, _ in tables_of(section).values():
        yield from sections(table)


def test_all_keys_of_all_tables_are_told_as_a_job_file(capfd: pytest.CaptureFixture[str]) -> None:
    text = told(capfd)
    content = tomllib.loads(text)
    assert content["prior"] == {"smooth": {}, "frequency": {}}
    assert content["effects"] == [{}]
    lines = text.splitlines()
    for section in sections():
        for name in section.model_fields.keys() - tables_of(section).keys():
            assert any(line.startswith(f"# {name} = ") for line in lines), name


def test_one_table_has_the_tables_within_it(capfd: pytest.CaptureFixture[str]) -> None:
    text = told(capfd, "prior")
    assert text.startswith("[prior]\n")
    assert [line for line in text.splitlines() if line.startswith("[")] == [
        "[prior]",
        "[prior.smooth]",
        "[prior.frequency]",
    ]
    assert told(capfd, "[prior.smooth]").splitlines()[0] == "[prior.smooth]"
    assert "has to be given" in told(capfd, "effects")


@pytest.mark.parametrize(("table", "meant"), [("basi", "did you mean 'basis'"), ("x", "one of data, data.simulate")])
def test_another_is_refused_in_a_line(table: str, meant: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["keys", table]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert f"no table '{table}' in a job" in line
    assert meant in line
