"""What the command line offers: examples that hold, and what a shell completes."""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from itertools import dropwhile

import pytest

from hydrabeam_mpi.terminal.command_line import EXAMPLES, SHELLS, make_parser


def commands() -> dict[str, argparse.ArgumentParser]:
    (found,) = (action for action in make_parser()._actions if isinstance(action, argparse._SubParsersAction))
    return dict(found.choices)


@pytest.mark.parametrize("name", commands())
def test_examples_in_help_are_commands(name: str) -> None:
    told = commands()[name].format_help()
    assert any(f"hydrabeam {name}" in example for example in EXAMPLES[name])
    for example in EXAMPLES[name]:
        assert f"\n  {example}\n" in f"{told}\n"
        _, *words = dropwhile(lambda word: word != "hydrabeam", shlex.split(example))
        assert make_parser().parse_args(words).command == words[0]


def test_one_cannot_be_quiet_and_verbose(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        make_parser().parse_args(["infer", "job.toml", "-o", "out", "-q", "-v"])
    assert "not allowed with argument" in capfd.readouterr().err


@pytest.mark.parametrize(("given", "told"), [("two", "'two' is not a whole number"), ("4,0", "0 is less than one")])
def test_numbers_of_ranks_are_numbers(given: str, told: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        make_parser().parse_args(["plan", "job.toml", "--ranks", given])
    assert f"argument --ranks: {told}; see" in capfd.readouterr().err


def printed(shell: str, capfd: pytest.CaptureFixture[str]) -> str:
    pytest.importorskip("shtab")
    with pytest.raises(SystemExit, match="0"):
        make_parser().parse_args(["--print-completion", shell])
    return capfd.readouterr().out


@pytest.mark.parametrize("shell", SHELLS)
def test_each_shell_has_its_words(shell: str, capfd: pytest.CaptureFixture[str]) -> None:
    script = printed(shell, capfd)
    assert [name for name in EXAMPLES if name not in script] == []


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["in"], {"infer", "init"}),
        (["infer", "--over"], {"--overwrite"}),
        (["--print-completion", "z"], {"zsh"}),
        (["infer", "pyproj"], {"pyproject.toml"}),
    ],
)
def test_bash_completes(typed: list[str], offered: set[str], capfd: pytest.CaptureFixture[str]) -> None:
    words = " ".join(map(shlex.quote, ["hydrabeam", *typed]))
    script = f"""{printed("bash", capfd)}
COMP_WORDS=({words}); COMP_CWORD={len(typed)}; COMP_LINE={shlex.quote(words)}; COMP_POINT=${{#COMP_LINE}}
_shtab_hydrabeam hydrabeam "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD-1]}}"
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    said = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    assert set(said.stdout.split()) == offered, said.stderr


def test_help_needs_no_more_than_python_has() -> None:
    source = "import sys\nfrom hydrabeam_mpi.terminal.command_line import make_parser\nmake_parser().format_help()\n"
    source += "print([name for name in ('shtab', 'numpy', 'astropy') if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    assert said.stdout == "[]\n"
