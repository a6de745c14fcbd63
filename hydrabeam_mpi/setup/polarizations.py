"""Several polarisations of one job: a problem for each, of which sky, array and rows are the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvsource import Data
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.setup.given import Given
from hydrabeam_mpi.setup.problem import Problem, of_polarization, prepare

FIELD = "[data] polarization"


def jobs_of_each(job: Job) -> list[Job]:
    """Return the job of each of a job's polarisations alone."""
    return [
        job.model_copy(update={"data": job.data.model_copy(update={"polarization": (pol,)})})
        for pol in job.data.polarization
    ]


def check_can_be_together(job: Job, given: Given) -> None:
    """Make sure that a job of several polarisations has nothing that is of one alone.

    Raises
    ------
    InputError
        If it has.
    """
    pols = job.data.polarization
    if len(pols) == 1:
        return
    of_one = {
        "effects ([[effects]])": bool(job.effects),
        "a prior from a file ([prior] file)": job.prior.kind == "file",
        "a prior that is adapted ([prior] widths)": job.prior.widths == "evidence",
        "a prior of its own": given.priors is not None or given.earlier is not None,
    }
    if found := next((what for what, is_there in of_one.items() if is_there), None):
        raise InputError(
            f"has {len(pols)} polarisations, and {found} is of one",
            field=FIELD,
            remedy=f'set polarization = "{pols[0]}", and run each by itself',
        )


def prepare_each(
    job: Job,
    files: tuple[Data, ...],
    truths: Mapping[str, tuple[Beam, ...]],
    given: Given,
    observation: Observation,
) -> list[Problem]:
    """Set up the problem of each of a job's polarisations. Serial.

    They share the sky and the rows.

    Parameters
    ----------
    job : Job
    files : tuple of Path or Source
        The visibilities.
    truths : mapping of str to tuple of callable
        The beams of each polarisation that they were simulated with, where they were.
    given : Given
    observation : Observation
        Of all polarisations.

    Raises
    ------
    InputError
        If a file or a setting cannot be used, or two names are of one polarisation.
    """
    if len(observation.pols) < len(job.data.polarization):
        raise InputError(
            f"{' and '.join(job.data.polarization)} are {len(observation.pols)} of the data",
            field=FIELD,
            remedy="name each once",
        )
    (first, *others), (pol, *more) = jobs_of_each(job), observation.pols
    alone = replace(observation, pols=(pol,))
    problem = prepare(first, files, truths.get(first.data.pol, ()), given, alone)
    return [
        problem,
        *(
            of_polarization(problem, other, name, truths.get(other.data.pol, ()), given)
            for other, name in zip(others, more, strict=True)
        ),
    ]
