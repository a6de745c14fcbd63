"""A result as prior: what data of other nights say of the beam and of effects, of which these data know nothing.

With p(d_1, d_2 | b, x) = p(d_1 | b, x) p(d_2 | b, x) the posterior of a first night is the prior of a second one, and
the posterior that follows is that of both at once. So no data may come in twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import FactoredPrior
from hydrabeam_mpi.io.inferred import Inferred, read_inferred
from hydrabeam_mpi.io.same_data import integration_checksums
from hydrabeam_mpi.io.uvsource import Data
from hydrabeam_mpi.mpi import Comm, gather_objects, together

FIELD = "[prior] file"


def find_earlier(job: Job, observation: Observation, given: Inferred | None = None) -> Inferred | None:
    """Return the result that is the prior of a job, of the job's channels; None where there is none. Serial.

    Parameters
    ----------
    job : Job
    observation : Observation
    given : Inferred, optional
        In place of a folder.

    Raises
    ------
    InputError
        If it cannot be the prior of these data.
    """
    folder = job.prior.file
    if given is None and (folder is None or not folder.is_dir()):
        return None
    result = given or read_inferred(Path(folder or ""), FIELD)
    with result.telling():
        _check_basis(job, result)
    numbers = result.channels_in(observation).tolist()
    if result.entries and numbers != list(range(len(result.content.channels))):
        raise InputError(
            f"the result has effects in {len(result.content.channels)} channels, of which these are {len(numbers)}",
            field="[data] freqs",
            remedy="select all of the result's channels",
        )
    return result.of_channels(numbers)


def beam_priors(result: Inferred) -> tuple[FactoredPrior, ...]:
    """Return what a result says of each channel's beam, effects marginalised.

    Raises
    ------
    InputError
        If that is no Gaussian.
    """
    n, priors = result.basis.n_modes, []
    with result.telling():
        for channel, record in enumerate(result.content.channels):
            priors.append(prior_of(record.arrays["mean"][:n], result.covariance_of(channel)[:n, :n]))
    return tuple(priors)


def prior_of(mean: Any, covariance: Any) -> FactoredPrior:
    """Return the Gaussian of a mean, (n,), and a covariance, (n, n), as a prior.

    Raises
    ------
    InputError
        If it is no covariance.
    """
    try:
        found = Posterior.of(mean, covariance)
    except np.linalg.LinAlgError as error:
        raise InputError("is no covariance", field="covariance", remedy="make the result again") from error
    return FactoredPrior(found.mean, found.factor)


def _check_basis(job: Job, result: Inferred) -> None:
    """Make sure that the coefficients are those of the same functions."""
    told = result.content.provenance.get("job", {}).get("basis", {})
    own = job.basis.model_dump(mode="json", exclude_none=True)
    if told != own:
        other = ", ".join(f"{name} = {value!r}" for name, value in told.items() if own.get(name) != value)
        raise InputError(
            f"is of another basis than the job's: {other}",
            field="basis",
            remedy="set the job's [basis] to the result's",
        )


def integrations_of(world: Comm, files: Sequence[Data], observation: Observation) -> list[str]:
    """Return the checksums of all integrations, on rank 0; empty on other ranks. Collective: all ranks of `world`."""
    with together(world):
        mine = integration_checksums(files, observation, world.rank, world.size)
    return [told for part in gather_objects(world, mine) or [] for told in part]


def check_not_counted(world: Comm, files: Sequence[Data], observation: Observation, result: Inferred) -> None:
    """Make sure that a result that is the prior knows nothing of these data yet, whatever file they are in.

    Collective: all ranks of `world`.

    Raises
    ------
    InputError
        On all ranks, if it does, or does not tell what it was made from.
    """
    with together(world), result.telling():
        known = result.integrations
    for data in files:
        own = integrations_of(world, [data], observation)
        with together(world), result.telling():
            n_known = sum(one in known for one in own)
            if n_known:
                raise InputError(
                    f"was made from the same data, {data}, which would count twice ({n_known} of {len(own)} "
                    f"integrations)",
                    file=result.path,
                    remedy="give data that the result was not made from, or another prior",
                )
