"""A few antennas, times and modes for chains, and truths and data drawn from the prior."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.fit.state import Estimate, Values
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.sampling.begin import begin
from hydrabeam_mpi.sampling.proposal import Proposal
from hydrabeam_mpi.sampling.state import ChainState
from hydrabeam_mpi.sampling.walk import Walk
from tests.loop.mock import FREQ, context_of, mock_job

GAINS = {"kind": "antenna_gains", "width": 0.2}
DRIFTING_GAINS = {**GAINS, "settings": {"law": "correlated", "kernel": "dpss", "minutes": 360}}
FLUX = {"kind": "catalogue_flux", "foremost": 2, "width": 2.0}
COUPLING = {"kind": "cross_coupling", "settings": {"baselines": [[0, 1], [1, 2]]}, "width": 0.2}
DIFFUSE = {"kind": "diffuse", "settings": {"l_max": 1}, "width": 0.1, "draw_widths": True}
POINTING = {"kind": "antenna_pointing", "width": 15.0}


def small_job(
    *effects: dict[str, Any],
    blocks: tuple[str, ...] = (),
    n_modes: int = 3,
    n_freqs: int = 1,
    n_times: int = 6,
    **sample: Any,
) -> dict[str, Any]:
    """Four antennas, half of the times fitted, twenty sources; beam, the given effects, and ``blocks`` are drawn."""
    kinds = [str(one["kind"]) for one in effects]
    job = mock_job(
        n_times=n_times,
        freqs=tuple(FREQ + 8e6 * number for number in range(n_freqs)),
        holdout={"every": 2},
        sky={"n_sources": 20},
        basis={"n_modes": n_modes, "k_max": n_modes},
        sample={"blocks": ["beam", *blocks, *kinds], "effects": list(effects), **sample},
    )
    job["data"]["simulate"]["array"] = {"hex": [1, 2]}
    return job


def walk_about_prior(folder: Path, job: dict[str, Any], signal_to_noise: float = 3.0) -> Walk:
    """Return a walk whose proposals know nothing of the data, of which they need not: those about the prior.

    The noise is such that a visibility by the prior is so many times larger.
    """
    walk = begin(context_of(job, folder))
    unknowns = walk.unknowns
    precision = unknowns.free.T @ unknowns.prior_precision() @ unknowns.free
    factor = np.linalg.cholesky(precision)
    half = solve_triangular(factor, unknowns.free.T, lower=True)
    proposal = Proposal(np.zeros(unknowns.size), half.T, factor.T @ unknowns.free.T)
    model = tuple(
        Posterior(prior.mean, one.factor) for prior, one in zip(walk.context.problem.priors, walk.seen_by, strict=True)
    )
    walk = replace(walk, proposal=proposal, seen_by=model)
    states = [drawn_from_prior(walk, generator(5, "size", number)) for number in range(20)]
    power = np.mean([np.abs(model_of(walk, one.values, one.beams)) ** 2 for one in states])
    rows = walk.context.train.rows
    weights = np.full_like(rows.inv_noise_var, signal_to_noise**2 / power)
    walk.context.train.rows = replace(rows, inv_noise_var=weights)
    return walk


def drawn_from_prior(walk: Walk, rng: np.random.Generator, step: float = 0.4) -> ChainState:
    """Draw all from its prior; where beams may not be negative, anew until they are not."""
    while True:
        state = _drawn_from_prior(walk, rng, step)
        if walk.positive is None or all(map(walk.positive.holds, state.beams)):
            return state


def _drawn_from_prior(walk: Walk, rng: np.random.Generator, step: float) -> ChainState:
    values = walk.unknowns.at(walk.proposal.vector(rng.standard_normal(walk.proposal.factor.shape[1])))
    n_local, n_groups = len(walk.channels), int(walk.group_of.max(initial=-1)) + 1
    noise, widths, parts = np.ones(n_local), np.ones((n_local, n_groups)), np.ones((n_local, 0))
    if walk.noise is not None and walk.parts is not None:
        parts = walk.noise.scale / rng.gamma(walk.noise.shape, size=(n_local, len(walk.parts.labels)))
    elif walk.noise is not None:
        noise = walk.noise.scale / rng.gamma(walk.noise.shape, size=n_local)
    if walk.widths is not None:
        widths = walk.widths.scale / rng.gamma(walk.widths.shape, size=(n_local, n_groups))
    pace = np.ones(walk.unknowns.n_freqs + 1)
    spreads = np.ones(0)
    if walk.spreads is not None:
        width_of = walk.unknowns.width_of
        spreads = walk.spreads.scale / rng.gamma(walk.spreads.shape, size=width_of.max() + 1)
        factor = np.where(width_of >= 0, np.sqrt(spreads[width_of]), 1.0)
        values = walk.unknowns.at(factor * walk.unknowns.vector(values))
    state = ChainState(values, (), noise, widths, parts, step * pace, pace, spreads)
    return replace(state, beams=tuple(_drawn(prior, rng) for prior in walk.priors(state)))


def _drawn(prior: Prior, rng: np.random.Generator) -> Any:
    shape = prior.mean.shape
    white = complex_normal(rng, shape) if np.iscomplexobj(prior.mean) else rng.standard_normal(shape)
    return prior.mean + prior.std() * white


def model_of(walk: Walk, values: Values, beams: tuple[Any, ...]) -> Any:
    """Return C (A b + E), (Nfreqs, Ntimes, Nbls)."""
    share = walk.context.train
    factor, added = share.effects(Estimate(values, walk.as_posteriors(beams)))
    seen = np.zeros_like(factor)
    for t, design in enumerate(share.designs(values)):
        for f, beam in enumerate(beams):
            parts = design[f] @ beam
            seen[f, t] = (parts if np.iscomplexobj(design) else parts[0] + 1j * parts[1])[share.rows.member]
    return factor * (seen + added)


def observe(walk: Walk, state: ChainState, rng: np.random.Generator) -> Walk:
    """Return the walk with data drawn where the state is; what has been worked out for others is forgotten."""
    share = walk.context.train
    model = model_of(walk, state.values, state.beams)
    noise = np.sqrt(state.noise[:, np.newaxis, np.newaxis] * walk.scale_of(share, state) / share.rows.inv_noise_var)
    if walk.dof is not None:
        noise /= np.sqrt(rng.gamma(walk.dof / 2, 2 / walk.dof, size=noise.shape))
    share.rows = replace(share.rows, data=model + noise * complex_normal(rng, model.shape))
    return replace(walk, **{name: type(getattr(walk, name))() for name in ("_sums", "_given", "_misfits")})
