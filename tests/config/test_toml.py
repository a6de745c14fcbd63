"""Whatever is given for a job file is read as TOML or refused in one line."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.config.toml import MAX_BYTES, read_toml
from hydrabeam_mpi.errors import InputError


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as raised:
        read_toml(path)
    return str(raised.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_text_with_or_without_a_mark(encoding: str, end: str, tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    path.write_bytes(f"name = 'Grünwald' # 面{end}seed = 3{end}when = 1979-05-27".encode(encoding))
    assert json.loads(read_toml(path)) == {"name": "Grünwald", "seed": 3, "when": "1979-05-27"}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[data]\nfiles = [", "is not a TOML file (Invalid value (at end of document)); close what is open:"),
        (b"seed = 1\nseed = 2\n", "is not a TOML file (Cannot overwrite a value (at line 2, column 9)); mend"),
        (b"name = 'a\0b'", "is not a TOML file (Found invalid character '\\x00' (at line 1, column 10)); mend"),
        (b"name = '\xff'", "is not text in UTF-8 (byte 9 is 0xff); name a job file, or save it as UTF-8"),
        (np.random.default_rng(1).bytes(10_000), "is not text in UTF-8 (byte "),
        ("name = 'a'".encode("utf-16"), "is text in UTF-16, not in UTF-8; save it as UTF-8"),
        ("name = 'a'".encode("utf-16-be"), "is not a TOML file ("),
        (b"\xfe\xff", "is text in UTF-16, not in UTF-8; save it as UTF-8"),
        (b"a = " + b"[" * 10_000 + b"]" * 10_000, "is nested too deeply; 'hydrabeam init' prints"),
        (b"a = " + b"{a=" * 10_000 + b"1" + b"}" * 10_000, "is nested too deeply; "),
        (b"a" + b".a" * 10_000 + b" = 1", "is nested too deeply; "),
        (b"[data]\nchannels = [1, [9223372036854775808]]", "data channels: is too large a number; it should be below"),
        (b"seed = -9223372036854775808", "seed: is too large a number; it should be below 2^63"),
        (b"seed = " + b"9" * 10_000, "holds too large a number; whole numbers should be below 2^63"),
    ],
    ids=lambda part: "",
)  # fmt: skip
def test_not_a_job(content: bytes, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    path.write_bytes(content)
    assert refusal(path).startswith(expected)


def test_what_no_job_file_is(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.toml") == "cannot be read (No such file or directory); check the path"
    assert refusal(tmp_path) == "is a folder; name the job file in it"
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    assert refusal(tmp_path / "loop.toml") == "cannot be read (Too many levels of symbolic links); check the path"
    (tmp_path / "large").touch()
    os.truncate(tmp_path / "large", MAX_BYTES + 1)
    assert refusal(tmp_path / "large").startswith("is too large for a job file; name the job")
