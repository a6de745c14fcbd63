"""The commands. The only place that takes the world communicator."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.extras import check_extra
from hydrabeam_mpi.mpi import (
    COMM_WORLD,
    INTERRUPTED_STATUS,
    Comm,
    check_one_world,
    end_interrupted,
    install_abort_hook,
    limit_blas_threads,
    refuse,
    together,
)
from hydrabeam_mpi.terminal.command_line import make_parser
from hydrabeam_mpi.terminal.console import console
from hydrabeam_mpi.terminal.interrupt import interruptible
from hydrabeam_mpi.terminal.progress import loudness, say, tell

if TYPE_CHECKING:
    from hydrabeam_mpi.config import Job

COMMANDS_WITH_EXTRAS = {"report": "plot", "sample": "chains"}
"""What commands need besides: see `hydrabeam_mpi.extras`."""


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
    world = COMM_WORLD
    with console(speaks=world.rank == 0):
        options = make_parser().parse_args(arguments)
        install_abort_hook(world)
        try:
            check_one_world(world)
            # What starts ranks passes a signal on to all of them; rank 0 may be waiting for another one.
            alone = world.size == 1 or world.rank > 0
            speaking = loudness(quiet=options.quiet, verbose=options.verbose)
            with speaking, interruptible(None if alone else lambda: end_interrupted(world)):
                _run(world, options)
        except InputError as error:
            return refuse(world, error)
        except KeyboardInterrupt:
            if world.size > 1:
                raise  # the hook ends the other ranks
            tell("interrupted")
            return INTERRUPTED_STATUS
    return 0


def _run(world: Comm, options: argparse.Namespace) -> None:
    """Dispatch. Commands are imported here so that `--help` does not wait for astronomy packages."""
    threads = limit_blas_threads(world)
    if options.command in COMMANDS_WITH_EXTRAS:
        with together(world):
            check_extra(COMMANDS_WITH_EXTRAS[options.command], options.command)
    if options.command in ("simulate", "infer", "loop"):
        _model(world, options, threads)
    elif options.command in ("predict", "correct"):
        from hydrabeam_mpi.commands.correct import correct
        from hydrabeam_mpi.commands.predict import predict

        command = predict if options.command == "predict" else correct
        command(world, options.result, options.job, options.output, options.overwrite, threads)
    elif options.command == "sample" and options.status is None:
        _sample(world, options)
    elif options.command == "plan":
        from hydrabeam_mpi.commands.plan import print_plan

        job = _job_with_files(world, options)
        print_plan(world, job, options.job, options.ranks, options.commands, options.found, options.json)
    else:
        with together(world):
            if world.rank == 0:
                _on_one_rank(options)


def _model(world: Comm, options: argparse.Namespace, threads: int) -> None:
    """Simulate, infer or close the loop.

    A mistake in the job or its paths is told before the packages that the work needs are imported: that takes seconds.
    """
    from hydrabeam_mpi.setup.job_file import check_paths, load, may_go_on

    simulates, loops = options.command == "simulate", options.command == "loop"
    job = load(world, options.job, simulates, loops, takes_several=not loops)
    overwrite = options.overwrite or (options.command == "loop" and may_go_on(job, options.output))
    check_paths(world, job, options.job, options.output, overwrite, simulates)
    if options.dry_run:
        _say_plan(world, options, job)
        return
    from hydrabeam_mpi.commands.infer import infer
    from hydrabeam_mpi.commands.loop import close_loop
    from hydrabeam_mpi.commands.simulate import simulate

    command = {"simulate": simulate, "infer": infer, "loop": close_loop}[options.command]
    command(world, job, options.job, options.output, options.overwrite, threads)


def _sample(world: Comm, options: argparse.Namespace) -> None:
    """Draw chains; mistakes are told before the packages that the work needs are imported."""
    with together(world):
        if options.job is None or options.output is None:
            remedy = "sample JOB.toml -o DIR, or --status DIR"
            raise InputError("needs a job and a folder", field="sample", remedy=remedy)
    job = _job_with_files(world, options)
    if options.dry_run:
        _say_plan(world, options, job)
        return
    from hydrabeam_mpi.commands.sample import sample

    sample(world, job, options.job, options.output, options.chains, options.draws)


def _job_with_files(world: Comm, options: argparse.Namespace) -> Job:
    """Read the job, and look whether its files can be read."""
    from hydrabeam_mpi.setup.job_file import load, read_files

    job = load(world, options.job)
    with together(world):
        if world.rank == 0:
            read_files(job)
    return job


def _on_one_rank(options: argparse.Namespace) -> None:
    """Do what other ranks have no part in."""
    if options.command == "sample":
        from hydrabeam_mpi.commands.sample_status import print_status

        print_status(options.status)
    elif options.command == "report":
        from hydrabeam_mpi.report.document import write_report

        write_report(options.directory, options.gains)
    elif options.command == "effects":
        from hydrabeam_mpi.commands.effects import print_effects

        print_effects(options.kind)
    elif options.command == "keys":
        from hydrabeam_mpi.commands.keys import print_keys

        print_keys(options.table)
    else:
        from hydrabeam_mpi.commands.init import job_from_data, write_job

        text = job_from_data(options.files)
        if options.output is None:
            print(text, end="")
        else:
            write_job(text, options.output, options.overwrite)


def _say_plan(world: Comm, options: argparse.Namespace, job: Job) -> None:
    """Say what a command would do, and what it would take on as many ranks as there are."""
    from hydrabeam_mpi.commands.plan import print_plan

    print_plan(world, job, options.job, (world.size,), (options.command,), 1, False)
    say(f"nothing has been done; without --dry-run, {options.command} would write {options.output}", world.rank == 0)
