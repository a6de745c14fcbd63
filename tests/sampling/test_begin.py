"""From a job to where its chains walk: what is drawn, with which prior, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.joint import fit_with_effects
from hydrabeam_mpi.sampling.begin import begin, first_state
from hydrabeam_mpi.sampling.state import Chance
from hydrabeam_mpi.sampling.sweep import sweep
from hydrabeam_mpi.sampling.variables import arrays_of, state_from, variables_of
from tests.loop.mock import context_of
from tests.sampling.small import COUPLING, FLUX, GAINS, small_job

FOUND = [
    {
        "kind": "antenna_gains",
        "names": ["antenna 1 ln amplitude", "antenna 2 phase"],
        "index": [2, 5],
        "values": [[0.01, -0.02]],
        "prior_std": [0.1, 0.1],
    },
    {
        "kind": "cross_coupling",
        "settings": {"baselines": [[0, 1]]},
        "names": ["baseline 0-1 real", "baseline 0-1 imaginary"],
        "index": [0, 1],
        "values": [[0.5, 0.1]],
        "prior_std": [0.3, 0.3],
    },
    {"kind": "noise_level", "values": [[1.5]]},
]


def test_what_a_loop_has_found_is_drawn(tmp_path: Path) -> None:
    """Its effects with their priors; its weights are taken as known. What is not named stays at its best values."""
    job = small_job(n_modes=12, blocks=()) | {"effects": FOUND}
    job["sample"]["blocks"] = []
    context = context_of(job, tmp_path)
    walk = begin(context)
    assert [one.kind for one in walk.unknowns.active] == ["antenna_gains", "cross_coupling"]
    assert [one.name for one in variables_of(walk)] == ["beam", "antenna_gains", "cross_coupling"]
    assert walk.unknowns.values.reweighted == ()
    np.testing.assert_allclose(walk.context.train.rows.inv_noise_var, context.train.rows.inv_noise_var / 1.5**2)
    np.testing.assert_allclose(np.diag(walk.unknowns.prior_precision()), [100, 100, 0.3**-2, 0.3**-2])
    job["sample"]["blocks"] = ["beam", "antenna_gains"]
    some = begin(context_of(job, tmp_path / "some"))
    assert some.unknowns.moving == (0,)
    before = first_state(some, 1, 0)
    after, accepted = sweep(some, before, Chance(1, 0, 0))
    assert set(accepted) == {"effects", "beam"}
    np.testing.assert_array_equal(after.values.active[1].x, some.unknowns.values.active[1].x)
    assert np.any(after.beams[0] != before.beams[0])


def test_beams_are_drawn_with_the_widths_that_the_data_want(tmp_path: Path) -> None:
    """Where the job asks for them; they are those of `infer`."""
    job = small_job(n_modes=12, blocks=())
    job["prior"] = {"fraction": 300.0, "widths": "evidence", "shape": False}
    context = context_of(job, tmp_path)
    walk = begin(context)
    wanted = fit_with_effects(context, Clock())
    assert wanted.values.prior_widths is not None
    (prior,), (stated,) = context.given(wanted.values).priors, context.problem.priors
    np.testing.assert_array_equal(walk.context.problem.priors[0].std(), prior.std())
    assert np.all(prior.std() < stated.std())
    state = first_state(walk, 1, 0)
    (beam,) = walk.beams_given(state).posteriors
    precision = beam.factor @ beam.factor.conj().T
    job["prior"]["widths"] = "stated"
    (wide,) = begin(context_of(job, tmp_path / "stated")).beams_given(state).posteriors
    added = np.diag(precision - wide.factor @ wide.factor.conj().T).real
    rounding = 1e-12 * float(np.diag(precision).real.max())
    np.testing.assert_allclose(added, prior.std() ** -2.0 - stated.std() ** -2.0, rtol=0, atol=rounding)


def test_a_state_comes_back_from_what_is_stored(tmp_path: Path) -> None:
    """Held combinations of gains stay at zero on the way."""
    job = small_job(GAINS, FLUX, COUPLING, blocks=("noise", "prior_width"), n_modes=12)
    walk = begin(context_of(job, tmp_path))
    state, _ = sweep(walk, first_state(walk, 1, 3), Chance(1, 3, 0))
    arrays = arrays_of(walk, state)
    assert {one.name: one.shape for one in variables_of(walk)} == {
        name: array.shape for name, array in arrays.items() if name != "pace"
    }
    back = state_from(walk, arrays)
    for one, two in (
        (back.step, state.step),
        (back.scale, state.scale),
        (back.noise, state.noise),
        (back.widths, state.widths),
        (back.beams[0], state.beams[0]),
    ):
        np.testing.assert_array_equal(one, two)
    for one, two in zip(back.values.active, state.values.active, strict=True):
        np.testing.assert_array_equal(one.x, two.x)
        np.testing.assert_allclose(two.x @ two.degenerate_directions.T, 0, atol=1e-12)


def test_proposals_learn_in_the_warm_up_alone(tmp_path: Path) -> None:
    walk = begin(context_of(small_job(GAINS, n_modes=12), tmp_path))
    state = first_state(walk, 1, 0)
    learnt, _ = sweep(walk, state, Chance(1, 0, 0, warming_up=True))
    kept, _ = sweep(walk, state, Chance(1, 0, 0))
    np.testing.assert_array_equal([kept.step, kept.scale], [state.step, state.scale])
    assert np.any(learnt.step != state.step) or np.any(learnt.scale != state.scale)
    np.testing.assert_array_equal(learnt.values.x, kept.values.x)


@pytest.mark.parametrize(
    ("effects", "changes", "words"),
    [
        ([], {"blocks": ["beam", "catalogue_flux"]}, "nothing to be drawn"),
        ([{"kind": "antenna_gains", "foremost": 3}], {}, "has no candidates"),
        ([{"kind": "missing_sources", "foremost": 3}], {}, "matter more than others"),
        ([{"kind": "antenna_delays"}], {}, "channels"),
        (
            [{**COUPLING, "prior_std": {"baseline 9-0 real": 0.1}}],
            {},
            "no parameter 'baseline 9-0 real'",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    effects: list[dict[str, Any]], changes: dict[str, Any], words: str, tmp_path: Path
) -> None:
    context = context_of(small_job(*effects, **changes) if not changes else _changed(changes), tmp_path)
    with pytest.raises(InputError, match=words) as caught:
        begin(context)
    assert "sample" in str(caught.value)


def _changed(changes: dict[str, Any]) -> dict[str, Any]:
    job = small_job()
    return job | {"sample": job["sample"] | changes}


def test_single_parameters_have_widths_of_their_own(tmp_path: Path) -> None:
    """By name, in their units; the others that of the effect."""
    one = {**COUPLING, "prior_std": {"baseline 0-1 imaginary": 0.05}}
    (active,) = begin(context_of(small_job(one, n_modes=12), tmp_path)).unknowns.active
    np.testing.assert_allclose(active.prior.of(0).std(), [0.2, 0.05, 0.2, 0.2])


def test_modes_of_one_order_have_one_width(tmp_path: Path) -> None:
    context = context_of(_changed({"blocks": ["prior_width"], "width_groups": "radial"}), tmp_path)
    orders = [k for k, _ in context.problem.basis.describe()["modes"]]
    assert begin(context).group_of.tolist() == [k - 1 for k in orders]
