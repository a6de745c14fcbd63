"""A sweep leaves the joint posterior as it is: where truth and data are drawn from the prior, so is what it draws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from hydrabeam_mpi.random import generator
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.sweep import sweep
from hydrabeam_mpi.sampling.walk import Walk
from tests.sampling import small
from tests.sampling.small import (
    COUPLING,
    FLUX,
    GAINS,
    POINTING,
    drawn_from_prior,
    observe,
    small_job,
    walk_about_prior,
)

FALSE_ALARM = 1e-3
"""Probability that a right sweep fails a case, were its seed another one."""
WIDE_GAINS = {**GAINS, "width": 0.5}
CASES: dict[str, tuple[dict[str, Any], int, float]] = {
    "beam and noise": (small_job(blocks=("noise",), noise_prior=[8.0, 8.0]), 200, 3.0),
    "complex beam and its prior's width": (
        small_job(blocks=("prior_width",), width_prior=[6.0, 6.0], width_groups="azimuthal")
        | {"basis": {"form": "complex", "n_modes": 5, "k_max": 3, "m_max": 2}},
        200,
        3.0,
    ),
    "noise by antenna": (small_job(blocks=("noise",), noise_prior=[3.0, 3.0], noise_groups="antenna"), 200, 3.0),
    "outliers": (small_job(blocks=("noise",), noise_prior=[3.0, 3.0], noise_dof=2.0), 200, 3.0),
    "noise by length, and what the beam sees": (
        small_job(POINTING, blocks=("noise",), noise_prior=[3.0, 3.0], noise_groups="length", noise_dof=6.0),
        60,
        8.0,
    ),
    "outliers, and effects given the beam": (small_job(WIDE_GAINS, noise_dof=3.0, collapsed=False), 100, 2.0),
    "what multiplies": (small_job(GAINS), 200, 3.0),
    "gains that are correlated in time": (small_job(small.DRIFTING_GAINS, n_times=8), 80, 3.0),
    "the sky": (small_job(FLUX), 150, 3.0),
    "what the beam sees": (small_job(POINTING), 100, 8.0),
    "two channels that see a beam": (small_job(POINTING, n_freqs=2), 60, 8.0),
    "all together, in two channels": (
        small_job(
            GAINS,
            FLUX,
            COUPLING,
            blocks=("noise", "prior_width"),
            n_freqs=2,
            noise_prior=[8.0, 8.0],
            width_prior=[6.0, 6.0],
        ),
        150,
        3.0,
    ),
    "power of diffuse emission": (small_job(small.DIFFUSE, width_prior=[4.0, 4.0]), 100, 3.0),
    "beam nowhere negative, all together in two channels": (
        small_job(
            GAINS,
            FLUX,
            blocks=("noise", "prior_width"),
            n_freqs=2,
            noise_prior=[8.0, 8.0],
            width_prior=[6.0, 6.0],
            positive_beam="90 deg",
        ),
        80,
        3.0,
    ),
    "beam nowhere negative, and the sky": (small_job({**FLUX, "width": 10.0}, positive_beam="15 deg"), 400, 1.0),
    "beam nowhere negative, that is seen": (small_job(POINTING, positive_beam="15 deg"), 50, 8.0),
    "given the beam": (small_job(WIDE_GAINS, collapsed=False), 120, 2.0),
    "given the beam that sees": (small_job(POINTING, collapsed=False), 60, 8.0),
}
"""What is drawn, how often, and how many times larger than the noise a visibility is."""
PARTS_OF_OTHERS = (
    "what the beam sees",
    "given the beam that sees",
    "noise by length, and what the beam sees",
    "beam nowhere negative, and the sky",
    "beam nowhere negative, that is seen",
)
"""What of these others draw as well."""


def told(walk: Walk, state: ChainState) -> Any:
    """Return numbers of a state and its data, of which the mean is to be the same before and after a sweep."""
    white = walk.proposal.white(walk.unknowns.vector(state.values))
    beams = np.concatenate(
        [
            (beam - prior.mean) / prior.std()
            for prior, beam in zip(walk.context.problem.priors, state.beams, strict=True)
        ]
    )
    parts = np.concatenate([white, beams.real, beams.imag if np.iscomplexobj(beams) else []])
    exact = walk.misfit(state.values, state.beams)
    # What the beam makes of E is of very different size from one truth to the next.
    seen = np.arcsinh(exact - walk.misfit_seen_by_fit(state.values, state.beams))
    scales = np.log(np.concatenate([state.noise, state.widths.ravel(), state.parts.ravel()]))
    squares, _ = walk.squares(walk.context.train, state)
    # Noise of Student's t may have no variance.
    of_noise = [np.arcsinh(squares).sum(), walk.log_likelihood(state), scales.sum()]
    exact = np.zeros(0) if walk.dof else exact / state.noise
    both = [parts, parts**2, parts[:-1] * parts[1:], scales, scales**2]
    return np.concatenate(
        [*both, exact, of_noise, seen, [walk.log_prior(state)], np.log(state.spreads), np.log(state.spreads) ** 2]
    )


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.study] * (name in PARTS_OF_OTHERS)) for name in CASES]
)
def test_what_is_drawn_is_as_likely_as_the_truth(name: str, tmp_path: Path) -> None:
    """Truth and sweep are exchangeable in every number of theirs and the data (Geweke 2004; Gandy and Scott 2020).

    Each repetition has a truth and data of its own, so that they are independent and the test's size is known.
    """
    job, n, signal_to_noise = CASES[name]
    walk = walk_about_prior(tmp_path, job, signal_to_noise)
    differences, taken = [], []
    for number in range(n):
        rng = generator(21, name, number)
        truth = drawn_from_prior(walk, rng)
        walk = observe(walk, truth, rng)
        state = truth
        for count in range(2):
            state, accepted = sweep(walk, state, Chance(22, number, count))
            taken.append(list(accepted.values()))
        differences.append(told(walk, state) - told(walk, truth))
    moved = np.std(differences, axis=0) > 1e-9
    off = np.mean(differences, axis=0)[moved] / (np.std(differences, axis=0)[moved] / np.sqrt(n))
    assert np.all(np.mean(taken, axis=0) > 0.1), np.mean(taken, axis=0)
    assert np.abs(off).max() < norm.isf(FALSE_ALARM / len(off) / 2), off.round(1)
