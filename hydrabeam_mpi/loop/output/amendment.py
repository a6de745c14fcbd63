"""The job with the effects that were found, for later runs of `infer`."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.effects import Effect as EffectEntry
from hydrabeam_mpi.config.sections import Prior
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.error_scale import ErrorScale
from hydrabeam_mpi.fit.prior_widths import as_stated
from hydrabeam_mpi.fit.state import Active, Fitted


def amended_job(job: Job, fitted: Fitted, setup: ObservingSetup, scale: ErrorScale | None = None) -> Job:
    """Return the job with the fitted effects and their priors, from which `infer` comes to the same fit.

    The beam's prior is as it was adapted.
    The errors that it tells are larger than those by the noise alone by ``scale``, where it is given.
    """
    entries = []
    for one, by_noise in zip(fitted.values.active, fitted.fit.std, strict=True):
        std = by_noise if scale is None else scale.of(one, by_noise)
        used = one.used
        entries.append(
            EffectEntry.model_construct(
                kind=one.effect.kind,
                settings=one.effect.describe(),
                names=tuple(name for name, _ in one.labels(setup)),
                index=tuple(int(i) for i in used),
                values=_rows(one.x[:, used]),
                std=_rows(std[:, used]),
                prior_std=_widths(one),
            )
        )
    for change in fitted.values.reweighted:
        kind = change.change.kind
        settings = change.change.describe()
        entry = EffectEntry.model_construct(kind=kind, settings=settings, values=_rows(change.x), std=_rows(change.std))
        entries.append(entry)
    return job.model_copy(update={"effects": tuple(entries), "prior": _prior_of(job, fitted)})


def effects_found(job: Job, fitted: Fitted, setup: ObservingSetup) -> dict[str, Any]:
    """Return what ``posterior.h5`` says of the fitted effects; see `hydrabeam_mpi.io.posterior_file`."""
    entries = [entry.model_dump(mode="json") for entry in amended_job(job, fitted, setup).effects]
    for entry, one in zip(entries, fitted.values.active, strict=False):
        entry["known"] = one.effect.parameters(setup).names
    return {"basis": setup.basis.describe(), "entries": entries}


def _prior_of(job: Job, fitted: Fitted) -> Prior:
    """Return the prior with the widths that the fit has, which no data are to adapt any further."""
    prior, widths = job.prior, fitted.values.prior_widths
    if widths is None and prior.widths != "evidence":
        return prior
    as_fitted = as_stated(widths) if widths is not None else {}
    # What is the default beside widths by the data is not beside stated ones.
    return Prior.model_validate(prior.model_dump() | as_fitted | {"widths": "stated", "shape": prior.has_shape})


def _widths(one: Active) -> tuple[tuple[float, ...], ...]:
    """Return the prior's widths, once where they are the same in all channels."""
    widths = np.array([one.prior.of(f).std() for f in range(len(one.x))])
    return _rows(widths[:1] if np.all(widths == widths[0]) else widths)


def _rows(values: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in values)
