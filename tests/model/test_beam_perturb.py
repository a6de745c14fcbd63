"""The perturbed beam against the paper's equations written out."""

import numpy as np
import pytest
from scipy.special import j0, j1, jn_zeros

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
from hydrabeam_mpi.model.perturb import PerturbedBeam
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.tables import embedded_beam

ALPHA = np.sqrt(1 - np.cos(23 * np.pi / 45))
SEED = 11


def few_modes():
    modes = [(1, 0), (2, 0), (5, 2), (5, -2), (8, 3), (8, -3)]
    coeffs = np.array([20, 3, 1 + 1j, 1 - 1j, 0.5j, -0.5j])
    return CoefficientBeam(FourierBessel(modes, form="complex"), coeffs, BeamInfo("few", 1e8, "ee")), modes, coeffs


def directions():
    rng = generator(1, "directions")
    return np.concatenate([[0.0, np.pi / 2], rng.uniform(0, np.pi / 2, 500)]), rng.uniform(-4, 4, 502)


def stretched(za, az, a, b):
    return np.sqrt(1 - np.cos(za)) / ALPHA * np.sqrt((np.cos(az) / a) ** 2 + (np.sin(az) / b) ** 2)


def modulation(rho):
    amplitudes = generator(SEED, "beam perturbation").standard_normal(8)
    return sum(c * np.sin(2 * np.pi * ALPHA * n * rho) for n, c in enumerate(amplitudes, start=1))


def test_perturbed_beam_is_the_paper_s():
    base, modes, coeffs = few_modes()
    za, az = directions()
    rho = stretched(za, az, 1.01, 1.02)
    everywhere = modulation(np.linspace(0, 1, 20001))
    theta = np.arccos(1 - (ALPHA * rho) ** 2)
    turn_on = 0.5 * (1 + np.tanh((theta - np.pi / 10) / (np.pi / 60)))
    gain = 1 + 0.2 / (everywhere.max() - everywhere.min()) * turn_on * modulation(rho)
    u = jn_zeros(0, 8)
    series = sum(
        value * j0(u[k - 1] * rho) / (j1(u[k - 1]) / np.sqrt(2)) * np.exp(1j * m * az) / np.sqrt(360)
        for (k, m), value in zip(modes, coeffs, strict=True)
    )
    np.testing.assert_allclose(PerturbedBeam(base, SEED)(za, az), gain * series.real, atol=1e-7)


def test_nothing_is_changed_without_stretch_and_modulation():
    base, _, _ = few_modes()
    za, az = directions()
    untouched = PerturbedBeam(base, SEED, stretch=(1.0, 1.0), sigma_sl=0.0)
    np.testing.assert_allclose(untouched(za, az), base(za, az), atol=1e-12)


def test_stretch_moves_the_pattern_outward_along_each_axis():
    base, _, _ = few_modes()
    beam = PerturbedBeam(base, SEED, stretch=(1.01, 1.02), sigma_sl=0.0)
    za = np.linspace(0, 1.2, 50)
    for az, factor in ((0.0, 1.01), (np.pi / 2, 1.02)):
        inner = 2 * np.arcsin(np.sin(za / 2) / factor)
        np.testing.assert_allclose(beam(za, np.full(50, az)), base(inner, np.full(50, az)), atol=1e-12)


def test_modulation_spares_the_main_lobe_and_keeps_its_range():
    base = embedded_beam()
    beam = PerturbedBeam(base, SEED, stretch=(1.0, 1.0), sigma_sl=0.2)
    za = np.deg2rad(np.linspace(0, 90, 500))
    ratio = beam(za, np.zeros(500)) / base(za, np.zeros(500))
    assert np.abs(ratio[za < np.deg2rad(9)] - 1).max() < 0.2 * 0.01
    assert 0.05 < np.ptp(ratio) <= 0.2 * 1.001


def test_perturbation_of_the_embedded_beam_is_slight():
    """Per cent in the main lobe, a fraction of a per cent of the peak in the sidelobes (HDBI II, figure 1)."""
    base = embedded_beam()
    za, az = np.meshgrid(np.deg2rad(np.arange(91)), np.deg2rad(np.arange(0, 360, 5)), indexing="ij")
    change = np.abs(PerturbedBeam(base, SEED)(za.ravel(), az.ravel()) - base(za.ravel(), az.ravel()))
    in_sidelobes = za.ravel() > np.deg2rad(20)
    assert 5e-3 < change[~in_sidelobes].max() < 3e-2
    assert 1e-5 < change[in_sidelobes].max() < 3e-3


def test_seed_decides_the_modulation_alone():
    base, _, _ = few_modes()
    za, az = directions()
    one, again, other = (PerturbedBeam(base, seed)(za, az) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 1e-4
    assert "seed 1" in PerturbedBeam(base, 1).info.name
    assert PerturbedBeam(base, 1).info.freq == base.info.freq


def test_shrinking_from_beyond_the_rim_is_refused():
    base, _, _ = few_modes()
    assert np.isfinite(PerturbedBeam(base, 1, stretch=(0.985, 1.0))(*directions())).all()
    with pytest.raises(InputError, match=r"stretch.*0\.9830"):
        PerturbedBeam(base, 1, stretch=(0.98, 1.0))
