"""What every effect must satisfy: none comes into the catalogue without it."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from hydrabeam_mpi.config.effects import Kind
from hydrabeam_mpi.effects.base import Cause, Effect, ScannedEffect
from hydrabeam_mpi.effects.catalogue import EFFECTS, REWEIGHTINGS, SEPARATE, make_cause, make_effect
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.random import generator
from tests.effects.cases import CASES, Case, candidates, draw, experiment_of, places, set_up
from tests.effects.direct import C, assert_same, row_vectors, seen_by_the_beam, unit_vectors
from tests.effects.small import check_adjoint, check_derivative, check_recovery, matrix_at, part_of, with_effect


def test_the_catalogue_is_that_of_job_files() -> None:
    assert {*EFFECTS, *REWEIGHTINGS, *SEPARATE} == set(get_args(Kind))
    assert set(CASES) <= set(EFFECTS)
    titles = [one.title for one in (*EFFECTS.values(), *REWEIGHTINGS.values(), *SEPARATE.values())]
    assert len(set(titles)) == len(titles)
    assert all(title == title.strip() and title[0].islower() for title in titles)


def cause_of(kind: str) -> tuple[Cause, Experiment]:
    if kind in SEPARATE:
        return make_cause(kind, {}), replace(experiment_of((131e6,), 4, 60), file_pols=("ee", "nn", "en", "ne"))
    effect, scene, _ = set_up(kind)
    return effect, scene.experiment


@pytest.mark.parametrize("kind", [*EFFECTS, *SEPARATE])
def test_parameters_have_names_units_scales_and_elements(kind: str) -> None:
    effect, experiment = cause_of(kind)
    parameters = effect.parameters(experiment)
    n = len(parameters)
    assert n > 0
    assert len(set(parameters.names)) == len(parameters.names) == n
    assert all(name == name.strip() and name for name in parameters.names)
    assert len(parameters.units) == n
    assert parameters.scale.shape == parameters.element.shape == parameters.refined.shape == (n,)
    assert np.all(np.isfinite(parameters.scale) & (parameters.scale > 0))
    n_elements = len(np.unique(parameters.element))
    np.testing.assert_array_equal(np.unique(parameters.element), np.arange(n_elements))
    assert parameters.trials >= n_elements
    # Every element is found by something before it is refined.
    assert set(parameters.element[~parameters.refined]) == set(range(n_elements))
    held = effect.undecidable(experiment)
    assert held.shape == (len(held), n)
    np.testing.assert_allclose(held @ held.T, np.diag(np.diag(held @ held.T)), atol=1e-12)


@pytest.mark.parametrize("kind", [*EFFECTS, *SEPARATE])
def test_it_is_what_its_kind_and_description_say(kind: str) -> None:
    effect, experiment = cause_of(kind)
    described = make_cause(kind, json.loads(json.dumps(effect.describe(), allow_nan=False)))
    for again in (described, pickle.loads(pickle.dumps(effect))):
        assert again.kind == kind
        assert again.describe() == effect.describe()
        one, two = effect.parameters(experiment), again.parameters(experiment)
        assert (one.names, one.units, one.trials) == (two.names, two.units, two.trials)
        for name in ("scale", "element", "refined"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize("kind", [*EFFECTS, *SEPARATE])
def test_draws_are_told_by_their_seed(kind: str) -> None:
    effect, experiment = cause_of(kind)
    x = draw(effect, experiment, 1.0)
    assert x.shape == (len(effect.parameters(experiment)),)
    assert np.all(np.isfinite(x))
    assert x.any()
    np.testing.assert_array_equal(draw(effect, experiment, 1.0), x)
    if isinstance(effect, Effect):
        one, two = (effect.drawn(experiment, generator(3, "drawn")) for _ in range(2))
        assert one.describe() == two.describe()
        assert len(one.parameters(experiment)) > 0
        n_freqs = experiment.observation.Nfreqs
        assert effect.objection(np.tile(x, (n_freqs, 1)), np.tile(0.01 * np.abs(x), (n_freqs, 1))) is None


@pytest.mark.parametrize("kind", EFFECTS)
def test_without_strength_nothing_changes(kind: str) -> None:
    effect, scene, _ = set_up(kind)
    for x in (np.zeros(len(effect.parameters(scene.experiment))), draw(effect, scene.experiment, 0.0)):
        assert_same(with_effect(effect, scene, x), scene.vis, scene, rtol=1e-12)
        assert_same(seen_by_the_beam(effect, scene, x), scene.vis, scene, rtol=1e-12)


@pytest.mark.parametrize("kind", EFFECTS)
def test_it_multiplies_or_adds_or_changes_the_sky(kind: str) -> None:
    effect, scene, case = set_up(kind)
    x = draw(effect, scene.experiment, case.strengths[0])
    assert not (effect.multiplies and effect.changes_sky)
    assert np.abs(with_effect(effect, scene, x) - scene.vis).max() > 0
    assert effect.added(scene, x).shape == effect.factor(scene, x).shape == scene.shape
    assert effect.added(scene, x).any() == (not effect.multiplies)
    assert np.any(effect.factor(scene, x) != 1) == effect.multiplies
    # What changes the sky is seen by the beam: its fluxes and further sources give what it adds.
    expected = with_effect(effect, scene, x) if effect.changes_sky else scene.vis
    assert_same(seen_by_the_beam(effect, scene, x), expected, scene, rtol=1e-12)


@pytest.mark.parametrize("kind", EFFECTS)
def test_columns_are_the_derivative_of_the_exact_change(kind: str) -> None:
    effect, scene, case = set_up(kind)
    for x in places(effect, scene, case):
        check_derivative(effect, scene, x, step=case.step)
        check_adjoint(effect, scene, x)


@pytest.mark.parametrize("kind", [kind for kind in EFFECTS if CASES.get(kind, Case()).noise is not None])
def test_an_injected_truth_is_recovered(kind: str) -> None:
    effect, scene, case = set_up(kind)
    assert case.noise is not None
    x = draw(effect, scene.experiment, case.strengths[0])
    change = with_effect(effect, scene, x) - scene.vis
    refined = effect.parameters(scene.experiment).refined
    start = np.where(refined, 0.0, 0.8 * x) if refined.any() else None
    check_recovery(effect, scene, x, sigma=case.noise * float(np.abs(change).max()), start=start)


@pytest.mark.parametrize("kind", EFFECTS)
def test_what_is_undecidable_looks_like_another_beam(kind: str) -> None:
    """At every time, by a beam of any values towards the few sources there are."""
    effect, scene, _ = set_up(kind, n_sources=12)
    held = effect.undecidable(scene.experiment)
    if not len(held):
        return
    design = matrix_at(effect, scene, np.zeros(held.shape[1]))
    other = generator(2, "other").standard_normal(held.shape)
    left: dict[str, list[float]] = {"held": [], "other": []}
    for t, itime in enumerate(scene.times.tolist()):
        towards = unit_vectors(scene, itime)
        beams = np.exp(2j * np.pi * scene.freq / C * (row_vectors(scene) @ towards))
        for name, directions in (("held", held), ("other", other)):
            change = design[t] @ directions.T
            parts = [np.concatenate([part.real, part.imag]) for part in (beams, change)]
            told = parts[1] - parts[0] @ np.linalg.lstsq(*parts)[0]
            left[name].append(float(np.abs(told).max() / np.abs(design).max()))
    assert max(left["held"]) < 1e-10
    assert max(left["other"]) > 0.01


LACKING: dict[str, Callable[[Experiment], Experiment]] = {
    "one channel": lambda one: replace(one, observation=replace(one.observation, freqs=one.observation.freqs[:1])),
    "one time": lambda one: replace(one, times=one.times[:1]),
    "unlike feeds": lambda one: replace(one, observation=replace(one.observation, pols=("en",))),
}
REFUSED = {
    ("antenna_delays", "one channel"): "several channels",
    ("cable_reflections", "one channel"): "4 channels",
    ("cross_coupling", "one time"): "several times",
    ("auto_coupling", "one time"): "several times",
    ("auto_coupling", "unlike feeds"): "equal feeds",
    ("mutual_coupling", "unlike feeds"): "equal feeds",
    ("antenna_positions", "unlike feeds"): "'en'",
    ("antenna_pointing", "unlike feeds"): "'en'",
    ("nonredundant_beams", "unlike feeds"): "'en'",
    ("basis_truncation", "unlike feeds"): "'en'",
    ("timestamp", "unlike feeds"): "'en'",
    ("ionosphere", "unlike feeds"): "'en'",
}


@pytest.mark.parametrize("kind", EFFECTS)
def test_it_is_refused_in_words_where_the_data_cannot_carry_it(kind: str) -> None:
    effect = make_effect(kind, {})
    case = CASES.get(kind, Case())
    experiment = experiment_of(case.freqs, case.n_times, case.n_sources)
    assert effect.refusal(experiment) is None
    for lack, without in LACKING.items():
        refusal, word = effect.refusal(without(experiment)), REFUSED.get((kind, lack))
        assert (refusal is None) == (word is None), f"{lack}: {refusal}"
        if refusal is not None and word is not None:
            assert word in refusal
            assert len(refusal.split()) > 5
            assert refusal == refusal.strip().rstrip(".")
            assert "\n" not in refusal


@pytest.mark.parametrize("kind", EFFECTS)
def test_some_rows_have_what_they_have_among_all(kind: str) -> None:
    """So that sums over rows are those of scenes and ranks together, and parameters `local` are those of few rows."""
    effect, scene, case = set_up(kind)
    x = draw(effect, scene.experiment, case.strengths[0])
    whole, model = matrix_at(effect, scene, x), with_effect(effect, scene, x)
    for times, bls in parts(scene):
        some = part_of(scene, times, bls)
        some.integrate_for([effect])
        rows = np.ix_(times, bls)
        close = 1e-11 * float(np.abs(whole).max())
        np.testing.assert_allclose(matrix_at(effect, some, x), whole[rows], rtol=0, atol=close)
        assert_same(with_effect(effect, some, x), model[rows], scene, rtol=1e-11)
    n_times, n_bls = (np.count_nonzero(whole.any(axis=axis), axis=0).max() for axis in (1, 0))
    assert effect.local == ("times" if n_times == 1 else "baselines" if n_bls == 1 else None)


def parts(scene: Scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return a few of the times and baselines, and the others."""
    times, bls = np.arange(len(scene.times)), np.arange(len(scene.bls))
    return [(t, b) for t in (times[:1], times[1:]) for b in (bls[::3], np.delete(bls, bls[::3]))]


SCANNED = [kind for kind, effect in EFFECTS.items() if issubclass(effect, ScannedEffect)]


@pytest.mark.parametrize("kind", SCANNED)
def test_a_scan_has_the_columns_that_candidates_will_have(kind: str) -> None:
    effect, scene, case = set_up(kind)
    plain = make_effect(kind, {})
    assert isinstance(plain, ScannedEffect)
    sums, norms = plain.scan(scene)
    assert sums.shape == norms.shape == (plain.n_hypotheses(scene.experiment), sums.shape[1])
    chosen = candidates(plain, scene)
    parameters = effect.parameters(scene.experiment)
    linear = np.flatnonzero(~parameters.refined)
    np.testing.assert_array_equal(parameters.element[linear], np.repeat(np.arange(len(chosen)), sums.shape[1]))
    design = matrix_at(effect, scene, np.zeros(len(parameters)))[..., linear]
    expected = np.einsum("tb,tbp,tb->p", scene.weights, design.conj(), scene.residual).real
    power = np.einsum("tb,tbp->p", scene.weights, np.abs(design) ** 2)
    for found, told, rtol in zip((sums, norms), (expected, power), case.scan, strict=True):
        np.testing.assert_allclose(found[chosen].reshape(-1), told, rtol=0, atol=rtol * np.abs(told).max())
    # Those of parts of the rows add up.
    by_part = np.sum([plain.scan(part_of(scene, *part)) for part in parts(scene)], axis=0)
    for found, total in zip(by_part, (sums, norms), strict=True):
        np.testing.assert_allclose(found, total, rtol=0, atol=1e-11 * np.abs(total).max())


@pytest.mark.parametrize("kind", SCANNED)
def test_without_candidates_it_is_nothing(kind: str) -> None:
    _, scene, _ = set_up(kind)
    effect, nothing = make_effect(kind, {}), np.zeros(0)
    assert len(effect.parameters(scene.experiment)) == 0
    assert effect.columns(scene, nothing).matrix().shape[1] == 0
    np.testing.assert_array_equal(with_effect(effect, scene, nothing), scene.vis)
