"""The command line: what the commands are called, what they take, and an example of each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from hydrabeam_mpi.version import __version__

SHELLS = ("bash", "zsh", "tcsh")
EXAMPLES = {
    "simulate": ("mpiexec -n 4 hydrabeam simulate jobs/paper/job.toml -o mock", "hydrabeam init mock/data.uvh5"),
    "infer": ("mpiexec -n 8 hydrabeam infer job.toml -o result",),
    "loop": ("mpiexec -n 8 hydrabeam loop job.toml -o found", "hydrabeam report found"),
    "predict": ("mpiexec -n 8 hydrabeam predict result night2.toml -o prediction",),
    "correct": ("hydrabeam correct found -o corrected", "hydrabeam correct found night2.toml -o corrected2"),
    "sample": (
        "mpiexec -n 8 hydrabeam sample job.toml -o chains --chains 4 --draws 1000",
        "hydrabeam sample --status chains",
    ),
    "plan": ("hydrabeam plan job.toml --ranks 1,16,256 --commands infer",),
    "report": ("hydrabeam report result", "hydrabeam report result --gains night1.calfits"),
    "effects": ("hydrabeam effects", "hydrabeam effects antenna_gains"),
    "keys": ("hydrabeam keys", "hydrabeam keys basis"),
    "init": (
        "hydrabeam init night1.uvh5 night2.uvh5 -o job.toml",
        "hydrabeam init data.uvh5 gains.calfits beam.beamfits sky.skyh5 -o job.toml",
    ),
}
"""Of each command; the tests parse them."""


class _Parser(argparse.ArgumentParser):
    """Complains in one line, as the rest of the program does."""

    def error(self, message: str) -> NoReturn:
        print(f"hydrabeam: error: {message}; see '{self.prog} --help'", file=sys.stderr)
        raise SystemExit(2)


class _PrintCompletion(argparse.Action):
    """Prints what a shell needs to complete commands, options and file names."""

    def __call__(self, parser: argparse.ArgumentParser, *values: Any) -> NoReturn:
        import shtab

        for command in parser._subparsers._group_actions[0].choices.values():  # type: ignore[union-attr]
            for action in command._actions:
                if action.type is Path:
                    action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
        print(shtab.complete(parser, values[1]))
        raise SystemExit(0)


def make_parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    parser = _Parser(
        prog="hydrabeam",
        description="Infer the primary beam of an interferometer from its visibilities.",
        epilog="For several processes: mpiexec -n N hydrabeam COMMAND ... 'hydrabeam COMMAND --help' has examples.",
    )
    parser.add_argument("--version", action="version", version=f"hydrabeam_mpi {__version__}")
    completion = "print what a shell completes commands with, for its start-up file"
    parser.add_argument("--print-completion", choices=SHELLS, action=_PrintCompletion, help=completion)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    simulate = "make mock data: data.uvh5, sky.skyh5, true_beam.beamfits and truth.h5"
    infer = "infer the beam: posterior.h5, beam.beamfits, summary.json"
    loop = "infer, find what the model lacks and add it: also loop.json, amended.toml"
    for name, what in (("simulate", simulate), ("infer", infer), ("loop", loop)):
        command = _add(commands, name, what)
        command.add_argument("job", type=Path, metavar="JOB.toml", help="job file")
        _add_output(command)
        _add_dry_run(command)
    command = _add(commands, "predict", "predict other data with a result, without fitting: prediction.json")
    command.add_argument("result", type=Path, metavar="RESULT", help="folder that infer or loop wrote")
    command.add_argument("job", type=Path, metavar="JOB.toml", help="job file of the other data")
    _add_output(command)
    what = "take the instrument's effects of a result out of data: corrected, model, residual, gains"
    command = _add(commands, "correct", what)
    command.add_argument("result", type=Path, metavar="RESULT", help="folder that infer or loop wrote")
    command.add_argument("job", type=Path, nargs="?", metavar="JOB.toml", help="other data than the result's own")
    _add_output(command)
    _add_sample(commands)
    _add_plan(commands)
    report = _add(commands, "report", "draw the figures and report.html of a result")
    report.add_argument("directory", type=Path, metavar="DIR", help="folder that infer, loop or sample wrote")
    compare = "compare with gains that were not applied to the data (calfits)"
    report.add_argument("--gains", type=Path, nargs="+", default=[], metavar="FILE", help=compare)
    effects = _add(commands, "effects", "list what a loop looks for, or print equations, units and settings of one")
    effects.add_argument("kind", nargs="?", metavar="EFFECT", help="its name in the list")
    keys = _add(commands, "keys", "print what a job file may say: keys, defaults, units and meanings")
    keys.add_argument("table", nargs="?", metavar="TABLE", help="of one table, such as basis or prior.frequency")
    init = _add(commands, "init", "print a job file filled in from data files")
    kinds = "visibilities (uvh5, uvfits, measurement set, miriad); also gains, one beam, one sky"
    init.add_argument("files", type=Path, nargs="+", metavar="FILE", help=kinds)
    init.add_argument("-o", "--output", type=Path, metavar="JOB.toml", help="write it there instead")
    init.add_argument("--overwrite", action="store_true", help="replace JOB.toml where it is there")
    return parser


def _add(commands: Any, name: str, what: str) -> argparse.ArgumentParser:
    """Add a command with its examples, and what all commands take."""
    examples: Sequence[str] = EXAMPLES[name]
    command: argparse.ArgumentParser = commands.add_parser(
        name,
        help=what,
        description=what,
        epilog="\n  ".join((f"example{'s'[: len(examples) > 1]}:", *examples)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    loudness = command.add_mutually_exclusive_group()
    loudness.add_argument("-q", "--quiet", action="store_true", help="say no more than warnings and errors")
    loudness.add_argument("-v", "--verbose", action="store_true", help="say more often how far it is, and the time")
    return command


def _add_sample(commands: Any) -> None:
    what = "draw beam, effects and noise together: chains that grow, and go on with the same command"
    command = _add(commands, "sample", what)
    command.add_argument("job", type=Path, nargs="?", metavar="JOB.toml", help="job file")
    command.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder of the chains")
    command.add_argument("--chains", type=_number, metavar="C", help="how many, instead of the job's")
    command.add_argument("--draws", type=_number, metavar="M", help="of each chain, instead of the job's")
    command.add_argument("--status", type=Path, metavar="DIR", help="show how far chains are, instead")
    _add_dry_run(command)


def _add_dry_run(command: argparse.ArgumentParser) -> None:
    what = "check job and files, say what would be done and what it would take, and write nothing"
    command.add_argument("--dry-run", action="store_true", help=what)


def _add_plan(commands: Any) -> None:
    plan = _add(
        commands, "plan", "forecast what a job will take: time, memory, bytes sent and written, by number of ranks"
    )
    plan.add_argument("job", type=Path, metavar="JOB.toml", help="job file")
    plan.add_argument("--ranks", type=_numbers, default=(1,), metavar="N,N,...", help="numbers of ranks; 1 by default")
    of = "of simulate, infer, loop and sample; all that the job can be given to by default"
    plan.add_argument("--commands", type=lambda text: text.split(","), metavar="NAME,NAME,...", help=of)
    plan.add_argument("--found", type=_number, default=1, metavar="K", help="effects that a loop is taken to find")
    plan.add_argument("--json", action="store_true", help="print JSON, in seconds and bytes")


def _number(text: str) -> int:
    """Read a number of chains, draws or ranks."""
    try:
        number = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number") from None
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is less than one")
    return number


def _numbers(text: str) -> tuple[int, ...]:
    """Read numbers of ranks."""
    return tuple(_number(one) for one in text.split(","))


def _add_output(command: argparse.ArgumentParser) -> None:
    command.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder to write")
    command.add_argument("--overwrite", action="store_true", help="replace DIR where it is an earlier result")
