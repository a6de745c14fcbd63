"""Integrations with a signal that redundant baselines share carry something unknown; others that stand out are bad."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.reweighting import Reweighting, ReweightingFit
from hydrabeam_mpi.effects.noise.bad_integrations import BadIntegrations
from hydrabeam_mpi.effects.noise.unknown_integrations import UnknownIntegrations
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup

EXPERIMENT = small_setup(n_times=40)
BLOCK = small_block(EXPERIMENT)
HELD: IntArray = np.arange(1, 40, 2)
FITTED: IntArray = np.arange(0, 40, 2)
BOTH: Sequence[Reweighting] = (BadIntegrations(), UnknownIntegrations())


def noise(seed: int) -> ComplexArray:
    return complex_normal(generator(seed, "noise"), BLOCK.shape)


def of_sky(seed: int, size: float) -> ComplexArray:
    """Return a row that redundant baselines have in common, (Nbls,)."""
    return size * complex_normal(generator(seed, "sky"), (len(BLOCK.groups),))[BLOCK.member]


def of_gains(seed: int, size: float) -> ComplexArray:
    """Return a row of what the gains of antennas that are off make of a sky, (Nbls,)."""
    gains = complex_normal(generator(seed, "gains"), (int(BLOCK.setup.antenna_index.max()) + 1,))
    return of_sky(seed, size) * (gains[BLOCK.ant1] + gains[BLOCK.ant2].conj())


def fits(z: ComplexArray) -> tuple[ReweightingFit, ReweightingFit]:
    """Ask for bad and for unknown integrations in the first of two channels, every second time of which is held out."""
    found = []
    for change in BOTH:
        sums = np.zeros((2, change.n_sums(EXPERIMENT)))
        fitted = np.where(np.isin(np.arange(40), FITTED)[:, np.newaxis], z, 0)
        sums[0] = change.sums(BLOCK, fitted) + change.heldout_sums(EXPERIMENT, HELD, BLOCK.bls, z[HELD])
        found.append(change.fit(EXPERIMENT, sums, np.zeros(2)))
    bad, unknown = found
    return bad, unknown


def told(fit: ReweightingFit) -> list[int]:
    return np.flatnonzero(fit.x[0] > 1).tolist()


def test_groups_have_several_baselines():
    assert np.bincount(BLOCK.member).max() > 1


@pytest.mark.parametrize("level", [1.0, 3.0])
def test_what_redundant_baselines_share_is_unknown(level: float):
    """In fitted and in held-out integrations; also beside residuals that are larger than noise."""
    for seed in range(20):
        z = noise(seed)
        z[[7, 20]] += of_sky(seed, 5.0), of_sky(seed + 20, 7.0)
        bad, unknown = fits(level * z)
        assert (told(bad), told(unknown)) == ([], [7, 20])
        assert unknown.log_bayes_factor > 50 > 0 == bad.log_bayes_factor


@pytest.mark.parametrize("row", [lambda seed: 5.0 * noise(seed + 1)[0], lambda seed: of_gains(seed, 5.0)])
def test_noise_and_gains_are_bad_integrations(row) -> None:
    for seed in range(20):
        z = noise(seed)
        z[7] += row(seed)
        bad, unknown = fits(z)
        assert (told(bad), told(unknown)) == ([7], [])


def test_one_with_noise_and_another_with_a_signal():
    z = noise(2)
    z[7] += of_sky(1, 5.0)
    z[20] *= 5.0
    bad, unknown = fits(z)
    assert (told(bad), told(unknown)) == ([20], [7])


def test_sums_of_redundant_groups_add_up():
    """Over blocks of whole groups, as on several ranks."""
    change, z = BOTH[0], noise(3)
    z[:, 4] = 0  # flagged
    whole = change.heldout_sums(EXPERIMENT, np.arange(40), BLOCK.bls, z)
    parts: list[FloatArray] = [
        change.heldout_sums(EXPERIMENT, np.arange(40), BLOCK.bls[mine], z[:, mine])
        for mine in (BLOCK.member < 3, BLOCK.member >= 3)
    ]
    np.testing.assert_allclose(np.sum(parts, axis=0), whole, atol=1e-12)
    groups, rows, common, power = whole.reshape(2, -1, EXPERIMENT.observation.Ntimes)[1, 3:]
    known = np.delete(np.arange(len(BLOCK.member)), 4)
    own = [known[BLOCK.member[known] == one] for one in np.unique(BLOCK.member)]
    several = [one for one in own if len(one) > 1]
    assert np.all(groups == len(several))
    assert np.all(rows == sum(map(len, several)))
    means = sum(len(one) * np.abs(z[:, one].mean(axis=1)) ** 2 for one in several)
    np.testing.assert_allclose(common, means)
    np.testing.assert_allclose(power, sum(np.sum(np.abs(z[:, one]) ** 2, axis=1) for one in several))
