"""What every effect must satisfy: none comes into the catalogue without it."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Cause, Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.registry import EFFECTS, KINDS, REWEIGHTINGS, SEPARATE, make_cause, make_effect
from hydrabeam_mpi.effects.sky.missing_sources import SPECTRAL_INDEX, MissingSources
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.random import generator
from tests.effects.cases import CASES, IN_TIME, VARIANTS, Case, candidates, draw, experiment_of, places, set_up
from tests.effects.direct import C, assert_same, row_vectors, seen_by_the_beam, unit_vectors
from tests.effects.small import (
    check_adjoint,
    check_derivative,
    check_recovery,
    matrix_at,
    part_of,
    small_block,
    with_effect,
)


def test_no_two_have_one_name() -> None:
    assert len(set(KINDS)) == len(KINDS) == len(EFFECTS) + len(REWEIGHTINGS) + len(SEPARATE)
    assert set(CASES) - set(IN_TIME) - set(VARIANTS) <= set(EFFECTS)
    assert set(IN_TIME) == {f"{kind}, {law}" for kind, one in EFFECTS.items() for law in one.laws}
    titles = [one.title for one in (*EFFECTS.values(), *REWEIGHTINGS.values(), *SEPARATE.values())]
    titles += [title for one in EFFECTS.values() for title in one.laws.values()]
    assert len(set(titles)) == len(titles)
    assert all(title == title.strip() and title[0].islower() for title in titles)


def cause_of(kind: str) -> tuple[Cause, ObservingSetup]:
    if kind in SEPARATE:
        return make_cause(kind, {}), replace(experiment_of((131e6,), 4, 60), file_pols=("ee", "nn", "en", "ne"))
    effect, block, _ = set_up(kind)
    return effect, block.setup


@pytest.mark.parametrize("kind", [*EFFECTS, *SEPARATE, *IN_TIME])
def test_parameters_have_names_units_scales_and_elements(kind: str) -> None:
    effect, setup = cause_of(kind)
    parameters = effect.parameters(setup)
    n = len(parameters)
    assert n > 0
    assert len(set(parameters.names)) == len(parameters.names) == n
    assert all(name == name.strip() and name for name in parameters.names)
    assert len(parameters.units) == n
    assert parameters.scale.shape == parameters.element.shape == parameters.nonlinear.shape == (n,)
    assert np.all(np.isfinite(parameters.scale) & (parameters.scale > 0))
    n_elements = len(np.unique(parameters.element))
    np.testing.assert_array_equal(np.unique(parameters.element), np.arange(n_elements))
    assert parameters.trials >= n_elements
    # Every element is found by something before it is refined.
    assert set(parameters.element[~parameters.nonlinear]) == set(range(n_elements))
    held = effect.degenerate_directions(setup)
    assert held.shape == (len(held), n)
    np.testing.assert_allclose(held @ held.T, np.diag(np.diag(held @ held.T)), atol=1e-12)


@pytest.mark.parametrize("kind", [*EFFECTS, *SEPARATE, *IN_TIME])
def test_it_is_what_its_kind_and_description_say(kind: str) -> None:
    effect, setup = cause_of(kind)
    described = make_cause(effect.kind, json.loads(json.dumps(effect.describe(), allow_nan=False)))
    for again in (described, pickle.loads(pickle.dumps(effect))):
        assert again.kind == kind.split(", ")[0]
        assert again.law == effect.law
        assert again.describe() == effect.describe()
        one, two = effect.parameters(setup), again.parameters(setup)
        assert (one.names, one.units, one.trials) == (two.names, two.units, two.trials)
        for name in ("scale", "element", "nonlinear"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize("kind", EFFECTS)
def test_what_comes_next_is_new_and_follows_its_own_kind_alone(kind: str) -> None:
    effect, setup = make_effect(kind, {}), set_up(kind)[1].setup
    for other in EFFECTS:
        following = effect.next_after(setup, make_effect(other, {}))
        assert following.kind == kind
        if other != kind:
            assert following is effect
        elif following is not effect:
            assert not set(following.parameters(setup).names) & set(effect.parameters(setup).names)
            assert following.next_after(setup, effect).describe() == following.describe()


@pytest.mark.parametrize("kind", EFFECTS)
def test_functions_of_the_beam_are_one_a_parameter(kind: str) -> None:
    """And the change is that of a beam with these coefficients."""
    effect, block, _ = set_up(kind)
    functions = effect.beam_functions(block.setup)
    assert functions is None or effect.is_about_the_beam
    if functions is not None:
        assert not effect.multiplies
        assert not effect.changes_sky
        assert not functions.is_complex
        x = draw(effect, block.setup, 1.0)
        assert functions.n_modes == len(x)
        change = block.integrate(lambda sources: functions.synthesize(x, sources.za, sources.az)[np.newaxis])
        np.testing.assert_allclose(effect.added(block, x), block.spread(change)[..., 0], rtol=1e-9)


@pytest.mark.parametrize("kind", EFFECTS)
def test_effects_may_be_claimed(kind: str) -> None:
    effect = make_effect(kind, {})
    assert not effect.is_control_model
    assert not (effect.gets_simpler_when_fitted and effect.linear)


@pytest.mark.parametrize("kind", [*EFFECTS, *SEPARATE])
def test_draws_are_told_by_their_seed(kind: str) -> None:
    effect, setup = cause_of(kind)
    x = draw(effect, setup, 1.0)
    assert x.shape == (len(effect.parameters(setup)),)
    assert np.all(np.isfinite(x))
    assert x.any()
    np.testing.assert_array_equal(draw(effect, setup, 1.0), x)
    one, two = (effect.drawn(setup, generator(3, "drawn")) for _ in range(2))
    assert one.describe() == two.describe()
    assert len(one.parameters(setup)) > 0
    if isinstance(one, Effect):
        x = np.tile(draw(one, setup, 1.0), (setup.observation.Nfreqs, 1))
        assert not one.beyond(setup, x, 0.01 * np.abs(x)).any()


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_without_strength_nothing_changes(kind: str) -> None:
    effect, block, _ = set_up(kind)
    for x in (np.zeros(len(effect.parameters(block.setup))), draw(effect, block.setup, 0.0)):
        assert_same(with_effect(effect, block, x), block.vis, block, rtol=1e-12)
        assert_same(seen_by_the_beam(effect, block, x), block.vis, block, rtol=1e-12)


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_it_multiplies_or_adds_or_changes_the_sky(kind: str) -> None:
    effect, block, case = set_up(kind)
    x = draw(effect, block.setup, case.strengths[0])
    assert not (effect.multiplies and effect.changes_sky)
    assert np.abs(with_effect(effect, block, x) - block.vis).max() > 0
    assert effect.added(block, x).shape == effect.factor(block, x).shape == block.shape
    assert effect.added(block, x).any() == (not effect.multiplies)
    assert np.any(effect.factor(block, x) != 1) == effect.multiplies
    # What changes the sky is seen by the beam: its fluxes and further sources give what it adds.
    expected = with_effect(effect, block, x) if effect.changes_sky else block.vis
    assert_same(seen_by_the_beam(effect, block, x), expected, block, rtol=1e-12)


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_phases_without_whole_turns_are_the_same(kind: str) -> None:
    effect, block, case = set_up(kind)
    x = draw(effect, block.setup, case.strengths[0])
    far = x + 20 * np.random.default_rng(3).normal(size=x.shape) * (
        np.array(effect.parameters(block.setup).units) == "rad"
    )
    nearest = effect.without_turns(block.setup, far)
    assert nearest.shape == far.shape
    assert np.all(np.abs(nearest) <= np.abs(far))
    if effect.multiplies:
        np.testing.assert_allclose(effect.factor(block, nearest), effect.factor(block, far), rtol=1e-12)
    np.testing.assert_array_equal(effect.without_turns(block.setup, np.stack([far, nearest])), [nearest, nearest])


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_it_says_whether_what_it_adds_is_in_proportion_to_the_beam(kind: str) -> None:
    effect, block, case = set_up(kind)
    if effect.multiplies or effect.changes_sky:
        return
    x, beam = draw(effect, block.setup, case.strengths[0]), block.beam

    def larger(za: FloatArray, az: FloatArray) -> FloatArray:
        return 1.3 * np.asarray(beam(za, az))

    other = replace(block, beam=larger, vis=1.3 * block.vis, design=1.3 * block.design, integrals={})
    scale = 1.3 if effect.is_seen_by_beam else 1.0
    # Where the sidelobes of one antenna are higher, its beam is still one at its peak.
    rtol = 2e-3 if kind == "nonredundant_beams" else 1e-9
    assert_same(effect.added(other, x), scale * effect.added(block, x), block, rtol)


# Compression and saturation are zero at what the model beam sees of the catalogue in the mean.
@pytest.mark.parametrize("kind", [kind for kind in (*EFFECTS, *IN_TIME) if kind not in {"compression", "saturation"}])
def test_sources_that_are_added_to_the_sky_are_seen_like_those_of_the_catalogue(kind: str) -> None:
    """A clock, antennas elsewhere or other beams do the same to either."""
    effect, block, case = set_up(kind)
    if effect.changes_sky:
        return
    setup, freqs = block.setup, block.setup.observation.freqs
    place = setup.observation.lsts[1] + 0.1, setup.observation.latitude - 0.2
    source = MissingSources([tuple(np.rad2deg(place))])
    x = np.eye(1, len(source.parameters(setup)))[0] * 30.0
    flux = 30.0 * (freqs / setup.reference_freq)[:, np.newaxis] ** SPECTRAL_INDEX
    sky = Sky(*(np.append(*one) for one in zip((setup.sky.ra, setup.sky.dec), place, strict=True)),
              np.append(setup.sky.flux, flux, axis=1))  # fmt: skip
    listed = replace(small_block(setup, block.channel, sky), weights=block.weights, residual=block.residual)
    found = replace(block, sky_effects=[(source, x)], vis=block.vis + source.added(block, x), integrals={})
    assert_same(found.vis, listed.vis, block)
    for strength in (0.0, case.strengths[0]):
        own = draw(effect, setup, strength)
        assert_same(effect.added(found, own), effect.added(listed, own), block)
        assert_same(effect.factor(found, own), effect.factor(listed, own), block)
        one, two = (matrix_at(effect, rows, own) for rows in (found, listed))
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-9 * np.abs(two).max())


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_columns_are_the_derivative_of_the_exact_change(kind: str) -> None:
    effect, block, case = set_up(kind)
    for x in places(effect, block, case):
        check_derivative(effect, block, x, step=case.step)
        check_adjoint(effect, block, x)


@pytest.mark.parametrize("kind", [kind for kind in (*EFFECTS, *IN_TIME) if CASES.get(kind, Case()).noise is not None])
def test_an_injected_truth_is_recovered(kind: str) -> None:
    effect, block, case = set_up(kind)
    assert case.noise is not None
    x = draw(effect, block.setup, case.strengths[0])
    change = with_effect(effect, block, x) - block.vis
    nonlinear = effect.parameters(block.setup).nonlinear
    start = np.where(nonlinear, 0.0, 0.8 * x) if nonlinear.any() else None
    check_recovery(effect, block, x, sigma=case.noise * float(np.abs(change).max()), start=start)


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_what_is_undecidable_looks_like_another_beam(kind: str) -> None:
    """At every time, by a beam of any values towards the few sources there are."""
    effect, block, _ = set_up(kind, n_sources=12)
    held = effect.degenerate_directions(block.setup)
    if not len(held):
        return
    design = matrix_at(effect, block, np.zeros(held.shape[1]))
    other = generator(2, "other").standard_normal(held.shape)
    left: dict[str, list[float]] = {"held": [], "other": []}
    for t, itime in enumerate(block.times.tolist()):
        towards = unit_vectors(block, itime)
        beams = np.exp(2j * np.pi * block.freq / C * (row_vectors(block) @ towards))
        for name, directions in (("held", held), ("other", other)):
            change = design[t] @ directions.T
            parts = [np.concatenate([part.real, part.imag]) for part in (beams, change)]
            told = parts[1] - parts[0] @ np.linalg.lstsq(*parts)[0]
            left[name].append(float(np.abs(told).max() / np.abs(design).max()))
    assert max(left["held"]) < 1e-10
    assert max(left["other"]) > 0.01


LACKING: dict[str, Callable[[ObservingSetup], ObservingSetup]] = {
    "one channel": lambda one: replace(one, observation=replace(one.observation, freqs=one.observation.freqs[:1])),
    "one time": lambda one: replace(one, times=one.times[:1]),
    "unlike feeds": lambda one: replace(one, observation=replace(one.observation, pols=("en",))),
}
REFUSED = {
    ("antenna_delays", "one channel"): "several channels",
    ("cable_reflections", "one channel"): "4 channels",
    ("common_beam", "one channel"): "several channels",
    ("spectral_index", "one channel"): "several channels",
    ("gain_jitter", "one time"): "several fitted times",
    ("moving_sources", "one time"): "3 fitted times",
    ("cross_coupling", "one time"): "several times",
    ("ground_emitter", "one time"): "several times",
    ("auto_coupling", "one time"): "several times",
    ("auto_coupling", "unlike feeds"): "equal feeds",
    ("polarised_sources", "unlike feeds"): "'en'",
    ("compression", "one time"): "several times",
    ("compression", "unlike feeds"): "equal feeds",
    ("saturation", "one time"): "3 times",
    ("saturation", "unlike feeds"): "equal feeds",
    ("mutual_coupling", "unlike feeds"): "equal feeds",
    ("antenna_positions", "unlike feeds"): "'en'",
    ("antenna_pointing", "unlike feeds"): "'en'",
    ("nonredundant_beams", "unlike feeds"): "'en'",
    ("basis_truncation", "unlike feeds"): "'en'",
    ("smearing", "unlike feeds"): "'en'",
    ("timestamp", "unlike feeds"): "'en'",
    ("orientation", "unlike feeds"): "'en'",
    ("array_scale", "unlike feeds"): "'en'",
    ("ionosphere", "unlike feeds"): "'en'",
}


@pytest.mark.parametrize("kind", EFFECTS)
def test_it_is_refused_in_words_where_the_data_cannot_carry_it(kind: str) -> None:
    effect = make_effect(kind, {})
    case = CASES.get(kind, Case())
    setup = experiment_of(case.freqs, case.n_times, case.n_sources)
    assert effect.not_applicable(setup) is None
    for lack, without in LACKING.items():
        not_applicable, word = effect.not_applicable(without(setup)), REFUSED.get((kind, lack))
        assert (not_applicable is None) == (word is None), f"{lack}: {not_applicable}"
        if not_applicable is not None and word is not None:
            assert word in not_applicable
            assert len(not_applicable.split()) > 5
            assert not_applicable == not_applicable.strip().rstrip(".")
            assert "\n" not in not_applicable


LIMITED = [kind for kind in (*EFFECTS, *IN_TIME) if EFFECTS[kind.split(", ")[0]].unphysical]


@pytest.mark.parametrize("kind", LIMITED)
def test_without_any_element_it_is_what_the_others_are(kind: str) -> None:
    """Where there are limits, beyond which elements are left out, also those that have something in common."""
    found, block, case = set_up(kind)
    effect = found.sought_in(block.setup)
    parameters, n_freqs = effect.parameters(block.setup), block.setup.observation.Nfreqs
    x, elements = draw(effect, block.setup, case.strengths[0]), parameters.element
    for element in np.unique(elements).tolist():
        fewer, left = effect.without(elements == element)
        assert list(fewer.parameters(block.setup).names) == [parameters.names[i] for i in left]
        assert element not in elements[left]
        of_each = np.tile(x[left], (n_freqs, 1))
        assert fewer.beyond(block.setup, of_each, np.full_like(of_each, 1e-3)).shape == (len(left),)
        others = np.zeros_like(x)
        others[left] = x[left]
        block.integrate_for([fewer])
        assert_same(with_effect(fewer, block, x[left]), with_effect(effect, block, others), block, rtol=1e-11)


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_some_rows_have_what_they_have_among_all(kind: str) -> None:
    """So that sums over rows are those of scenes and ranks together, and parameters `local` are those of few rows."""
    effect, block, case = set_up(kind)
    x = draw(effect, block.setup, case.strengths[0])
    whole, model = matrix_at(effect, block, x), with_effect(effect, block, x)
    for times, bls in parts(block):
        some = part_of(block, times, bls)
        some.integrate_for([effect])
        rows = np.ix_(times, bls)
        close = 1e-11 * float(np.abs(whole).max())
        np.testing.assert_allclose(matrix_at(effect, some, x), whole[rows], rtol=0, atol=close)
        assert_same(with_effect(effect, some, x), model[rows], block, rtol=1e-11)
    n_times, n_bls = (np.count_nonzero(whole.any(axis=axis), axis=0).max() for axis in (1, 0))
    assert effect.local == ("times" if n_times == 1 else "baselines" if n_bls == 1 else None)


def parts(block: RowBlock) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return a few of the times and baselines, and the others."""
    times, bls = np.arange(len(block.times)), np.arange(len(block.bls))
    return [(t, b) for t in (times[:1], times[1:]) for b in (bls[::3], np.delete(bls, bls[::3]))]


SCANNED = [kind for kind, effect in EFFECTS.items() if issubclass(effect, ScannedEffect)]


@pytest.mark.parametrize("kind", SCANNED)
def test_a_scan_has_the_columns_that_candidates_will_have(kind: str) -> None:
    effect, block, case = set_up(kind)
    plain = make_effect(kind, {})
    assert isinstance(plain, ScannedEffect)
    sums, norms = plain.scan(block)
    assert sums.shape == norms.shape == (plain.n_hypotheses(block.setup), sums.shape[1])
    chosen = candidates(plain, block)
    parameters = effect.parameters(block.setup)
    linear = np.flatnonzero(~parameters.nonlinear)
    np.testing.assert_array_equal(parameters.element[linear], np.repeat(np.arange(len(chosen)), sums.shape[1]))
    design = matrix_at(effect, block, np.zeros(len(parameters)))[..., linear]
    expected = np.einsum("tb,tbp,tb->p", block.weights, design.conj(), block.residual).real
    power = np.einsum("tb,tbp->p", block.weights, np.abs(design) ** 2)
    for found, told, rtol in zip((sums, norms), (expected, power), case.scan, strict=True):
        np.testing.assert_allclose(found[chosen].reshape(-1), told, rtol=0, atol=rtol * np.abs(told).max())
    # Those of parts of the rows add up.
    by_part = np.sum([plain.scan(part_of(block, *part)) for part in parts(block)], axis=0)
    for found, total in zip(by_part, (sums, norms), strict=True):
        np.testing.assert_allclose(found, total, rtol=0, atol=1e-11 * np.abs(total).max())


@pytest.mark.parametrize("kind", SCANNED)
def test_without_candidates_it_is_nothing(kind: str) -> None:
    _, block, _ = set_up(kind)
    effect, nothing = make_effect(kind, {}), np.zeros(0)
    assert len(effect.parameters(block.setup)) == 0
    assert effect.columns(block, nothing).matrix().shape[1] == 0
    np.testing.assert_array_equal(with_effect(effect, block, nothing), block.vis)
