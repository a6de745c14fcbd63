"""What every effect must satisfy in other data of the same array, in which everything stands in another order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import ComplexArray, IntArray
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS, make_effect, make_reweighting
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from tests.effects.cases import IN_TIME, Case, draw, experiment_of, set_up
from tests.effects.small import small_block, with_effect

OF_THESE_DATA = {"common_beam", "saturation"}
"""What other data do not have as it was found."""


def reordered(setup: ObservingSetup, keep: IntArray) -> ObservingSetup:
    """Return the setup with some baselines, each the other way round, and with its antennas in reverse."""
    observation = setup.observation
    other = replace(
        observation,
        antenna_numbers=observation.antenna_numbers[::-1].copy(),
        antenna_names=observation.antenna_names[::-1],
        antpos=observation.antpos[::-1].copy(),
        antpairs=observation.antpairs[keep, ::-1].copy(),
    )
    return replace(setup, observation=other, redundant=find_redundant_groups(other.bl_vectors, 1e-7))


def as_stored(block: RowBlock, values: ComplexArray) -> ComplexArray:
    """Turn visibilities, (Ntimes, Nbls), from the groups' sense into that of the baselines."""
    return np.where(block.setup.redundant.flipped, values.conj(), values)


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_it_does_the_same_to_the_same_antennas_and_sources(kind: str) -> None:
    effect, block, case = set_up(kind)
    keep = np.arange(block.setup.observation.Nbls)[::-1]
    setup = reordered(block.setup, keep)
    here = effect.carried_over(setup)
    if isinstance(here, str):
        assert kind in OF_THESE_DATA
        return
    names, numbers = effect.parameters(block.setup).names, here.known_as(here.parameters(setup).names)
    assert set(names) <= set(numbers)
    x, moved = draw(effect, block.setup, case.strengths[0]), np.zeros(len(names))
    for name, value in zip(names, x, strict=True):
        number, sign = numbers[name]
        moved[number] = sign * value
    other = small_block(setup, case.channel)
    other.integrate_for([here])
    one = as_stored(block, with_effect(effect, block, x))[:, keep]
    two = as_stored(other, with_effect(here, other, moved))
    np.testing.assert_allclose(two, one.conj(), rtol=1e-8, atol=1e-9 * np.abs(one).max())
    assert np.abs(two - as_stored(other, other.vis)).max() > 1e-6 * np.abs(one).max()


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_it_leaves_what_other_data_lack(kind: str) -> None:
    effect, block, _ = set_up(kind)
    observation = block.setup.observation
    gone = observation.antenna_numbers[2]
    setup = reordered(block.setup, np.flatnonzero(~np.any(observation.antpairs == gone, axis=1)))
    here = effect.carried_over(setup)
    if isinstance(here, Effect):
        names = here.parameters(setup).names
        assert {number for number, _ in here.known_as(names).values()} == set(range(len(names)))
        assert not any(name.startswith(f"antenna {gone} ") or f"baseline {gone}-" in name for name in names)


@pytest.mark.parametrize("kind", [*EFFECTS, *IN_TIME])
def test_what_multiplies_are_gains_of_antennas(kind: str) -> None:
    effect, block, case = set_up(kind)
    x = draw(effect, block.setup, case.strengths[0])
    gains = effect.gains(block.setup, block.channel, x)
    observation = block.setup.observation
    changes = effect.law != "constant" or (effect.multiplies and effect.local == "times") or kind == "saturation"
    at_times = (observation.Ntimes,) if changes else ()
    assert gains.shape == (*at_times, observation.Nants)
    product = np.broadcast_to(gains[..., block.ant1] * gains[..., block.ant2].conj(), block.shape)
    factor = effect.factor(block, x) if effect.has_gains else np.ones(block.shape)
    np.testing.assert_allclose(product, factor, rtol=1e-13)
    seen = effect.gains_seen(block, x)
    # Errors of single baselines are nobody's gains.
    assert (seen is None) == (kind == "closure_errors")
    if seen is not None:
        assert seen.shape == (len(block.times), observation.Nants)
        product = seen[:, block.ant1] * seen[:, block.ant2].conj()
        np.testing.assert_allclose(product, effect.factor(block, x), rtol=1e-9)


def test_noise_is_that_of_its_own_data() -> None:
    setup = experiment_of(Case().freqs, Case().n_times, Case().n_sources)
    for kind in EFFECTS:
        effect = make_effect(kind, {})
        held = effect.carried_over(setup)
        assert isinstance(held, str) == (kind in OF_THESE_DATA)
    for kind in REWEIGHTINGS:
        assert "data in which it was found" in make_reweighting(kind, {}).carried_over(setup)


def test_fluxes_are_of_the_sources_that_the_catalogue_has() -> None:
    setup = experiment_of(Case().freqs, Case().n_times, Case().n_sources)
    there = tuple(np.rad2deg([setup.sky.ra[3], setup.sky.dec[3]]))
    here = CatalogueFlux([(12.0, -80.0), there]).carried_over(setup)
    assert here.sources == (there,)
