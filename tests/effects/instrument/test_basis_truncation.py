import pickle
from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import C_M_PER_S, FloatArray
from hydrabeam_mpi.effects.instrument.basis_truncation import MOST_MODES, BasisTruncation
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.sky.diffuse import Diffuse
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.model.beam import analytic_beam
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.fit import fit_beam
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.tables import embedded_beam
from tests.effects.direct import assert_same, visibilities
from tests.effects.small import small_block, small_setup, with_effect

EDGE = np.deg2rad(92)


def with_basis(basis) -> ObservingSetup:
    """The small experiment with the embedded beam in another basis."""
    fit = fit_beam(embedded_beam(), basis)
    return replace(small_setup(), basis=basis, prior_mean=(fit.coeffs, fit.coeffs))


BASES = {
    "real": FourierBessel.full(6, 4, form="real", edge=EDGE, boundary="neumann"),
    "complex": FourierBessel.full(4, 3, form="complex", edge=EDGE, boundary="dirichlet"),
    "zernike": Zernike(6, EDGE),
}


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_beam_of_a_larger_basis_is_whole(basis) -> None:
    """A beam with modes that the basis lacks gives the visibilities that the effect says."""
    setup = with_basis(basis)
    block = small_block(setup)
    effect = BasisTruncation()
    modes = effect.next_modes(setup).modes
    assert not set(modes) & set(basis.modes)
    assert 0 < len(modes) <= basis.n_modes
    x = effect.draw(setup, generator(2, "truncation"), 1.0)
    at_edge = [m for k, m in modes if k == 0]
    if isinstance(basis, Zernike):
        extra = Zernike(max(n for n, _ in modes), EDGE)
        coeffs = np.concatenate([np.zeros(basis.n_modes), x])
    else:
        extra, coeffs = basis.with_modes(modes[len(at_edge) :], form="real"), x[len(at_edge) :]

    def beam(directions, row: int):
        za, az = np.arccos(directions[2]), np.arctan2(directions[1], directions[0])
        # Constant in radius with unit norm on the disc, as are cosine and sine of 360 azimuths.
        constant = [
            np.sqrt(2 * (2 - (m == 0)) / 360) * (np.cos(m * az) if m >= 0 else np.sin(-m * az)) for m in at_edge
        ]
        known = np.asarray(block.beam(za, az)).real + extra.synthesize(coeffs, za, az)
        return known + sum(value * row for value, row in zip(x, constant, strict=False))

    assert_same(with_effect(effect, block, x), visibilities(block, beam=beam), block)


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_modes_see_what_is_added_to_the_sky(basis) -> None:
    """A missing source is seen by a beam with the modes, as are those of the catalogue."""
    setup = with_basis(basis)
    source = MissingSources([tuple(np.rad2deg([setup.observation.lsts[1], setup.observation.latitude]))])
    flux = np.eye(1, len(source.parameters(setup)))[0]
    effect = BasisTruncation()
    functions = effect.beam_functions(setup)
    x = effect.draw(setup, generator(2, "truncation"), 1.0)
    changed = replace(small_block(setup), sky_effects=[(source, flux)])
    block = small_block(setup)
    seen = effect.added(changed, x) - effect.added(block, x)

    def larger(za: FloatArray, az: FloatArray) -> FloatArray:
        return functions.synthesize(x, za, az)

    expected = source.added(replace(block, beam=larger), flux)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(seen, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("keeps", [True, False])
def test_modes_see_diffuse_emission_that_is_added(keeps: bool) -> None:
    """Whether or not there is room to keep what is seen of its harmonics; twice, with another sky the second time."""
    setup = with_basis(BASES["real"])
    block, effect, diffuse = small_block(setup), BasisTruncation(), Diffuse(2)
    functions = effect.beam_functions(setup)
    x = effect.draw(setup, generator(2, "truncation"), 1.0)

    def larger(za: FloatArray, az: FloatArray) -> FloatArray:
        return functions.synthesize(x, za, az)

    memo: dict | None = {} if keeps else None
    for seed in (1, 2):
        sky = diffuse.draw(setup, generator(seed, "diffuse"), 1.0)
        changed = replace(block, sky_effects=[(diffuse, sky)], memo=memo, integrals={})
        seen = effect.added(changed, x) - effect.added(replace(block, integrals={}), x)
        expected = np.zeros((len(block.times), len(block.groups)), dtype=complex)
        for t, itime in enumerate(block.times.tolist()):
            za, az, flux = diffuse.extra_sky(block, itime, sky)
            directions = enu(za, az)
            waves = np.exp(2j * np.pi * block.freq / C_M_PER_S * (block.vectors @ directions))
            expected[t] = 0.5 * waves @ (flux * larger(za, az))
        np.testing.assert_allclose(seen, block.spread(expected), atol=1e-9 * np.abs(expected).max())


def test_more_modes_at_once_begin_with_the_same() -> None:
    """Those of a batch have one width; more come until there are no more, or they are too many."""
    setup = with_basis(FourierBessel.full(24, 12, form="real", edge=EDGE, boundary="dirichlet"))
    effect, sizes = BasisTruncation(), []
    for larger in effect.larger(setup):
        modes, more = effect.next_modes(setup).modes, larger.next_modes(setup).modes
        assert more[: len(modes)] == modes
        sizes.append(len(np.unique(larger.parameters(setup).element)))
        effect = larger
    assert sizes == [2, 3]
    assert not BasisTruncation(0, MOST_MODES).larger(setup)
    assert not BasisTruncation().larger(with_basis(BASES["real"]))


class Unknown(FourierBessel):
    """A basis that does not say what comes next."""

    def next_modes(self, amplitudes: FloatArray, n_before: int, most: int) -> None:
        return None


def test_a_basis_that_does_not_know_its_next_modes_is_refused() -> None:
    reason = BasisTruncation().not_applicable(with_basis(Unknown([(1, 0), (2, 0)], edge=EDGE)))
    assert reason is not None
    assert "not known which functions come next" in reason
    assert all(BasisTruncation().not_applicable(with_basis(basis)) is None for basis in BASES.values())


def test_a_setup_that_has_been_of_use_goes_to_other_ranks() -> None:
    setup = small_setup()
    names = BasisTruncation().parameters(setup).names
    again = pickle.loads(pickle.dumps(setup))
    assert BasisTruncation().parameters(again).names == names


def test_what_is_beyond_a_basis_is_what_does_not_vanish_where_all_of_it_does() -> None:
    setup = with_basis(BASES["complex"])
    beyond = BasisTruncation().beyond_basis(setup)
    assert beyond is not None
    modes = beyond.next_modes(setup).modes
    assert sorted(modes) == [(0, m) for m in range(-3, 4)]
    at_edge = beyond.beam_functions(setup).evaluate(np.array([EDGE]), np.array([0.3]))
    own = setup.basis.evaluate(np.array([EDGE]), np.array([0.3]))
    assert np.all(np.abs(at_edge) > 1e-3)
    np.testing.assert_allclose(own, 0, atol=1e-12)
    # Once the beam has them nothing else is beyond it.
    after = BasisTruncation().next_after(setup, beyond)
    assert after.beyond_basis(setup) is None


@pytest.mark.parametrize("name", ["real", "zernike"])
def test_nothing_is_beyond_a_basis_that_is_free_at_the_edge(name: str) -> None:
    assert BasisTruncation().beyond_basis(with_basis(BASES[name])) is None


AIRY = analytic_beam("airy", 131e6, "ee", diameter=14.0)


def with_model_beam(basis: LinearBasis = BASES["real"]) -> ObservingSetup:
    """The small experiment with an Airy beam, of which the basis leaves something, in both channels."""
    coeffs = fit_beam(AIRY, basis).coeffs
    return replace(small_setup(), basis=basis, prior_mean=(coeffs, coeffs), model_beam=AIRY)


@pytest.mark.parametrize("form", ["real", "complex"])
def test_the_rest_makes_a_beam_in_the_basis_the_model_beam(form: str) -> None:
    """It comes first, and its part is one where the true beam is the model."""
    setup = with_model_beam(BASES[form])
    effect = BasisTruncation().sought_in(setup)
    assert effect.rest
    assert make_effect(effect.kind, effect.describe()).describe() == effect.describe()
    rest = effect.rest_of_model()
    assert rest is not None
    parameters, alone = effect.parameters(setup), rest.parameters(setup)
    assert alone.names == parameters.names[:1]
    assert parameters.scale[0] == alone.scale[0] == 1
    assert parameters.element[0] not in parameters.element[1:]
    functions = effect.beam_functions(setup)
    assert functions is not None
    assert functions.n_modes == len(parameters)
    block = small_block(setup)

    def beam(directions, row: int):
        return AIRY(np.arccos(directions[2]), np.arctan2(directions[1], directions[0]))

    # Next to the horizon, where the rest ends, its table is less exact.
    assert_same(with_effect(rest, block, np.ones(1)), visibilities(block, beam=beam), block, rtol=5e-5)
    assert np.abs(rest.added(block, np.ones(1))).max() > 1e-2 * np.abs(block.vis).max()
    x = np.eye(1, len(parameters))[0]
    np.testing.assert_allclose(effect.added(block, x), rest.added(block, np.ones(1)), rtol=1e-12)


def test_what_comes_after_the_rest_are_the_next_modes() -> None:
    setup = with_model_beam()
    rest = BasisTruncation(rest=True).rest_of_model()
    assert rest is not None
    after = BasisTruncation(rest=True).next_after(setup, rest)
    assert after.describe() == BasisTruncation().describe()
    both = BasisTruncation(rest=True)
    assert both.next_after(setup, both).describe() == after.next_after(setup, after).describe()
    assert all(larger.rest for larger in both.larger(setup))
    beyond = both.beyond_basis(setup)
    assert beyond is not None
    assert beyond.describe() == rest.describe()


def test_without_a_model_beam_or_beside_its_rest_there_is_none() -> None:
    assert not BasisTruncation().sought_in(small_setup()).rest
    reason = BasisTruncation(rest=True).not_applicable(small_setup())
    assert reason is not None
    assert "leaves nothing of the model beam" in reason
    fit = fit_beam(embedded_beam(), FourierBessel.selection(20, k_max=6, m_max=2, rest=True, boundary="neumann"))
    setup = replace(small_setup(), basis=fit.basis, prior_mean=(fit.coeffs,) * 2, model_beam=embedded_beam())
    assert not BasisTruncation().sought_in(setup).rest


def test_no_functions_are_refused() -> None:
    reason = BasisTruncation(n_modes=0).not_applicable(with_basis(BASES["real"]))
    assert reason is not None
    assert "ask for some" in reason
