import numpy as np
import pytest

from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.shared.point_sources import resolution, responses
from hydrabeam_mpi.effects.sky.diffuse import Diffuse
from hydrabeam_mpi.effects.sky.faint_sources import AT_FIRST, FaintSources
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources, candidates
from hydrabeam_mpi.model.sky import Sky, separation
from hydrabeam_mpi.random import generator
from tests.effects.small import check_adds_sources, small_block, small_setup


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return small_setup(n_times=8)


def test_equals_a_sky_with_the_sources_in_it(setup: ObservingSetup) -> None:
    effect = FaintSources(n_sources=12).sought_in(setup)
    ra, dec = np.deg2rad(effect.sources).T
    x = generator(3, "fluxes").standard_normal(12)
    fluxes = x * ((setup.observation.freqs / setup.reference_freq) ** -0.7)[:, np.newaxis]
    check_adds_sources(effect, setup, x, Sky(ra, dec, fluxes))


def test_the_first_point_is_the_one_that_is_seen_best(setup: ObservingSetup) -> None:
    """By the power of what baselines see of it at the times in use, among all points of the grid."""
    block = small_block(setup, setup.observation.Nfreqs // 2)
    ra, dec = candidates(setup)
    members = np.bincount(setup.redundant.group)[block.groups]
    power = np.einsum("tgs,g->s", np.abs(responses(block, ra, dec)) ** 2, members)
    first = FaintSources(n_sources=1).sought_in(setup).sources[0]
    np.testing.assert_allclose(np.deg2rad(first), (ra[power.argmax()], dec[power.argmax()]))


def test_points_hold_what_any_faint_source_gives(setup: ObservingSetup) -> None:
    """Of a source anywhere, as often as it is seen, the points leave little, and less than as many at random do."""
    block = small_block(setup)
    rng = generator(4, "sky")
    ra, dec = candidates(setup)
    wherever = np.stack([rng.choice(ra, 300), rng.choice(dec, 300)])
    seen = responses(block, *wherever).reshape(-1, 300)

    def left(effect: FaintSources) -> float:
        columns = effect.columns(block, np.zeros(effect.n_sources)).values.reshape(len(seen), -1)
        real = [np.concatenate([one.real, one.imag]) for one in (columns, seen)]
        basis = np.linalg.qr(real[0])[0]
        return float(np.sum((real[1] - basis @ (basis.T @ real[1])) ** 2) / np.sum(real[1] ** 2))

    chosen = [left(FaintSources(n_sources=n).sought_in(setup)) for n in (20, 60, 120)]
    assert chosen[0] > chosen[1] > chosen[2]
    assert chosen[2] < 0.1
    at_random = rng.choice(len(ra), 120, replace=False)
    others = FaintSources(np.rad2deg([ra[at_random], dec[at_random]]).T.tolist())
    assert chosen[2] < 0.7 * left(others)


def test_more_points_come_after_those_before(setup: ObservingSetup) -> None:
    first = FaintSources(n_sources=20).sought_in(setup)
    following = first.next_after(setup, first)
    assert isinstance(following, FaintSources)
    assert following.n_before == 20
    assert not set(following.sources) & set(first.sources)
    both = FaintSources(n_sources=20 + following.n_sources).sought_in(setup)
    assert both.sources == (*first.sources, *following.sources)
    assert first.next_after(setup, Diffuse()) is first
    for larger in FaintSources(n_sources=20).larger(setup):
        assert larger.sources[:20] == first.sources


def test_there_are_no_more_than_data_can_tell_apart() -> None:
    setup = small_setup((131e6,), n_times=1)
    every = FaintSources(n_sources=500).sought_in(setup)
    assert every.n_sources < 500
    values = every.columns(small_block(setup), np.zeros(every.n_sources)).values.reshape(-1, every.n_sources)
    assert np.linalg.matrix_rank(np.concatenate([values.real, values.imag])) == every.n_sources
    assert every.next_after(setup, every) is every
    assert every.larger(setup) == []


def test_what_is_looked_for_is_told_by_places(setup: ObservingSetup) -> None:
    """So that it is the same in other data, which would choose others."""
    sought = FaintSources().sought_in(setup)
    assert 0 < sought.n_sources <= AT_FIRST
    assert sought.parameters(setup).names == FaintSources().parameters(setup).names
    again = make_effect(sought.kind, sought.describe())
    other = small_setup((151e6,), n_times=3)
    assert again.parameters(other).names == sought.parameters(setup).names
    assert sought.carried_over(other) is sought


def test_its_brightest_spots_may_be_sources(setup: ObservingSetup) -> None:
    """Each with the flux of all within a resolution of it; far fainter spots, and what is not told, are none."""
    effect = FaintSources(n_sources=60).sought_in(setup)
    ra, dec = np.deg2rad(effect.sources).T
    at = np.flatnonzero(separation(ra, dec, ra[0], dec[0]) >= resolution(setup))
    other, far = int(at[0]), int(at[separation(ra[at], dec[at], ra[at[0]], dec[at[0]]) >= resolution(setup)][-1])
    beside = np.flatnonzero(separation(ra, dec, ra[0], dec[0]) < resolution(setup))[1:2]
    x, std = np.zeros((2, 60)), np.full((2, 60), 0.1)
    x[:, 0], x[:, other], x[:, far] = 5.0, 2.0, 0.1
    x[:, beside] = -0.5
    ((which, sources, begun),) = effect.simpler_elements(setup, x, std)
    assert which.all()
    assert isinstance(sources, MissingSources)
    assert sources.sources == (effect.sources[0], effect.sources[other])
    flux = np.array([name.endswith("flux") for name in sources.parameters(setup).names])
    np.testing.assert_allclose(begun[flux], [5.0 - 0.5 * len(beside), 2.0])
    assert not begun[~flux].any()
    std[:, 0] = 0.0
    ((_, sources, _),) = effect.simpler_elements(setup, x, std)
    assert isinstance(sources, MissingSources)
    assert sources.sources[0] == effect.sources[other]
    assert effect.simpler_elements(setup, -np.abs(x), std) == []
