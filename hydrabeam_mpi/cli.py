"""The commands. The only place that takes the world communicator."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi import (
    INTERRUPTED_STATUS,
    end_interrupted,
    install_abort_hook,
    limit_blas_threads,
    refuse,
    together,
)
from hydrabeam_mpi.terminal.console import console
from hydrabeam_mpi.terminal.interrupt import interruptible
from hydrabeam_mpi.terminal.progress import say
from hydrabeam_mpi.version import __version__


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Collective: all ranks of the world communicator.

    Parameters
    ----------
    arguments : sequence of str, optional
        Command line without the program's name; the process's own by default.

    Returns
    -------
    int
        Exit status: 0; 2 where the input is wrong, as is a command line that cannot be parsed; 130 if
        interrupted.
    """
    world = MPI.COMM_WORLD
    with console(speaks=world.rank == 0):
        options = _parser().parse_args(arguments)
        install_abort_hook(world)
        try:
            # What starts ranks passes a signal on to all of them; rank 0 may be waiting for another one.
            alone = world.size == 1 or world.rank > 0
            with interruptible(None if alone else lambda: end_interrupted(world)):
                _run(world, options)
        except InputError as error:
            return refuse(world, error)
        except KeyboardInterrupt:
            if world.size > 1:
                raise  # the hook ends the other ranks
            say("interrupted")
            return INTERRUPTED_STATUS
    return 0


class _Parser(argparse.ArgumentParser):
    """Complains in one line, as the rest of the program does."""

    def error(self, message: str) -> NoReturn:
        print(f"hydrabeam: error: {message}; see '{self.prog} --help'", file=sys.stderr)
        raise SystemExit(2)


def _parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    parser = _Parser(
        prog="hydrabeam",
        description="Infer the primary beam of an interferometer from its visibilities.",
        epilog="For several processes: mpiexec -n N hydrabeam COMMAND ...",
    )
    parser.add_argument("--version", action="version", version=f"hydrabeam_mpi {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    simulate = "make mock data: data.uvh5 and truth.h5"
    infer = "infer the beam: posterior.h5, beam.beamfits, summary.json"
    loop = "infer, find what the model lacks and add it: also loop.json, amended.toml"
    for name, what in (("simulate", simulate), ("infer", infer), ("loop", loop)):
        command = commands.add_parser(name, help=what, description=what)
        command.add_argument("job", type=Path, metavar="JOB.toml", help="job file")
        _add_output(command)
    what = "predict other data with a result, without fitting: prediction.json"
    command = commands.add_parser("predict", help=what, description=what)
    command.add_argument("result", type=Path, metavar="RESULT", help="folder that infer or loop wrote")
    command.add_argument("job", type=Path, metavar="JOB.toml", help="job file of the other data")
    _add_output(command)
    what = "take the instrument's effects of a result out of data: corrected, model, residual, gains"
    command = commands.add_parser("correct", help=what, description=what)
    command.add_argument("result", type=Path, metavar="RESULT", help="folder that infer or loop wrote")
    command.add_argument("job", type=Path, nargs="?", metavar="JOB.toml", help="other data than the result's own")
    _add_output(command)
    what = "draw beam, effects and noise together: chains that grow, and go on with the same command"
    command = commands.add_parser("sample", help=what, description=what)
    command.add_argument("job", type=Path, nargs="?", metavar="JOB.toml", help="job file")
    command.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder of the chains")
    command.add_argument("--chains", type=_number, metavar="C", help="how many, instead of the job's")
    command.add_argument("--draws", type=_number, metavar="M", help="of each chain, instead of the job's")
    command.add_argument("--status", type=Path, metavar="DIR", help="show how far chains are, instead")
    what = "forecast what a job will take: time, memory, bytes sent and written, by number of ranks"
    plan = commands.add_parser("plan", help=what, description=what)
    plan.add_argument("job", type=Path, metavar="JOB.toml", help="job file")
    plan.add_argument("--ranks", type=_numbers, default=(1,), metavar="N,N,...", help="numbers of ranks; 1 by default")
    of = "of simulate, infer, loop and sample; all that the job can be given to by default"
    plan.add_argument("--commands", type=lambda text: text.split(","), metavar="NAME,NAME,...", help=of)
    plan.add_argument("--found", type=_number, default=1, metavar="K", help="effects that a loop is taken to find")
    plan.add_argument("--json", action="store_true", help="print JSON, in seconds and bytes")
    what = "draw the figures and report.html of a result"
    report = commands.add_parser("report", help=what, description=what)
    report.add_argument("directory", type=Path, metavar="DIR", help="folder that infer, loop or sample wrote")
    compare = "compare with gains that were not applied to the data (calfits)"
    report.add_argument("--gains", type=Path, nargs="+", default=[], metavar="FILE", help=compare)
    what = "print a job file filled in from data files"
    init = commands.add_parser("init", help=what, description=what)
    kinds = "visibilities (uvh5, uvfits, measurement set, miriad); also gains, one beam, one sky"
    init.add_argument("files", type=Path, nargs="+", metavar="FILE", help=kinds)
    init.add_argument("-o", "--output", type=Path, metavar="JOB.toml", help="write it there instead")
    init.add_argument("--overwrite", action="store_true", help="replace JOB.toml where it is there")
    return parser


def _number(text: str) -> int:
    """Read a number of chains or draws."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is less than one")
    return number


def _numbers(text: str) -> tuple[int, ...]:
    """Read numbers of ranks."""
    return tuple(_number(one) for one in text.split(","))


def _add_output(command: argparse.ArgumentParser) -> None:
    command.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder to write")
    command.add_argument("--overwrite", action="store_true", help="replace DIR where it is an earlier result")


def _run(world: MPI.Comm, options: argparse.Namespace) -> None:
    """Dispatch. Commands are imported here so that `--help` does not wait for astronomy packages."""
    threads = limit_blas_threads(world)
    if options.command in ("simulate", "infer", "loop"):
        # A mistake in the job or its paths is told before the packages that the work needs are imported: that takes
        # seconds.
        from hydrabeam_mpi.setup.job_file import check_paths, load, may_go_on

        simulates = options.command == "simulate"
        job = load(world, options.job, simulates, options.command == "loop")
        overwrite = options.overwrite or (options.command == "loop" and may_go_on(job, options.output))
        check_paths(world, job, options.job, options.output, overwrite, simulates)
        from hydrabeam_mpi.commands.infer import infer
        from hydrabeam_mpi.commands.loop import close_loop
        from hydrabeam_mpi.commands.simulate import simulate

        command = {"simulate": simulate, "infer": infer, "loop": close_loop}[options.command]
        command(world, job, options.job, options.output, options.overwrite, threads)
        return
    if options.command == "predict":
        from hydrabeam_mpi.commands.predict import predict

        predict(world, options.result, options.job, options.output, options.overwrite, threads)
        return
    if options.command == "correct":
        from hydrabeam_mpi.commands.correct import correct

        correct(world, options.result, options.job, options.output, options.overwrite, threads)
        return
    if options.command == "sample" and options.status is None:
        _sample(world, options)
        return
    if options.command == "plan":
        from hydrabeam_mpi.setup.job_file import load, read_files

        job = load(world, options.job)
        with together(world):
            if world.rank == 0:
                read_files(job)
        from hydrabeam_mpi.commands.plan import print_plan

        print_plan(world, job, options.job, options.ranks, options.commands, options.found, options.json)
        return
    with together(world):
        if world.rank == 0 and options.command == "sample":
            from hydrabeam_mpi.commands.sample_status import print_status

            print_status(options.status)
        elif world.rank == 0 and options.command == "report":
            from hydrabeam_mpi.report.document import write_report

            write_report(options.directory, options.gains)
        elif world.rank == 0:
            from hydrabeam_mpi.commands.init import job_from_data, write_job

            text = job_from_data(options.files)
            if options.output is None:
                print(text, end="")
            else:
                write_job(text, options.output, options.overwrite)


def _sample(world: MPI.Comm, options: argparse.Namespace) -> None:
    """Draw chains; mistakes are told before the packages that the work needs are imported."""
    from hydrabeam_mpi.setup.job_file import load, read_files

    if options.job is None or options.output is None:
        raise InputError("needs a job and a folder", field="sample", remedy="sample JOB.toml -o DIR, or --status DIR")
    job = load(world, options.job)
    with together(world):
        if world.rank == 0:
            read_files(job)
    from hydrabeam_mpi.commands.sample import sample

    sample(world, job, options.job, options.output, options.chains, options.draws)
