from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.config.sections import Basis
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.basis_truncation import MOST_MODES, BasisTruncation, next_modes
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.model.fit import beam_pixels, fit_basis, fit_beam, select_largest
from hydrabeam_mpi.model.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.zernike import Zernike
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.tables import embedded_beam
from tests.effects.direct import assert_same, visibilities
from tests.effects.small import small_experiment, small_scene, with_effect

EDGE = np.deg2rad(92)


def with_basis(basis) -> Experiment:
    """The small experiment with the embedded beam in another basis."""
    fit = fit_beam(embedded_beam(), basis)
    return replace(small_experiment(), basis=basis, prior_mean=(fit.coeffs, fit.coeffs))


BASES = {
    "real": FourierBessel.full(6, 4, form="real", edge=EDGE, boundary="neumann"),
    "complex": FourierBessel.full(4, 3, form="complex", edge=EDGE, boundary="dirichlet"),
    "zernike": Zernike(6, EDGE),
}


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_beam_of_a_larger_basis_is_whole(basis) -> None:
    """A beam with modes that the basis lacks gives the visibilities that the effect says."""
    experiment = with_basis(basis)
    scene = small_scene(experiment)
    effect = BasisTruncation()
    modes = next_modes(experiment)
    assert not set(modes) & set(basis.modes)
    assert 0 < len(modes) <= basis.n_modes
    x = effect.draw(experiment, generator(2, "truncation"), 1.0)
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
        known = np.asarray(scene.beam(za, az)).real + extra.synthesize(coeffs, za, az)
        return known + sum(value * row for value, row in zip(x, constant, strict=False))

    assert_same(with_effect(effect, scene, x), visibilities(scene, beam=beam), scene)


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_amended_settings_hold_all_modes(basis) -> None:
    """Those of three rounds."""
    experiment = with_basis(basis)
    n_more = 0
    for _ in range(3):
        effect = BasisTruncation(n_more)
        n_more += len(effect.parameters(experiment))
    settings = effect.amended_basis_settings(experiment)
    n_modes = basis.n_modes + n_more
    if isinstance(basis, Zernike):
        assert Zernike(settings["max_degree"]).n_modes == n_modes
        assert Basis(kind="zernike", **settings).max_degree > basis.degree
    else:
        assert Basis(**settings).n_modes == n_modes
        if basis.boundary == "dirichlet":
            assert settings["boundary"] == "neumann"


def test_a_beam_that_is_not_zero_at_the_edge_needs_few_more_modes() -> None:
    basis = FourierBessel.full(20, 4, edge=EDGE, boundary="dirichlet")
    modes = next_modes(with_basis(basis))
    assert modes[:9] == [(0, 0), *[(0, sign * m) for m in range(1, 5) for sign in (1, -1)]]
    za, az = generator(3, "directions").uniform(0, 1, (2, 4000)) * np.array([[EDGE], [2 * np.pi]])
    beam = np.exp(-((za / 0.5) ** 2)) + 0.01 * (1 + 0.5 * np.cos(2 * az)) * np.cos(za / 4)

    def left(columns: FloatArray) -> float:
        return float(np.std(beam - columns.T @ np.linalg.lstsq(columns.T, beam, rcond=None)[0]))

    constant = FourierBessel([(1, m) for _, m in modes[:9]], "real", EDGE, "neumann").columns(za, az)
    known = basis.columns(za, az)
    more = FourierBessel.full(40, 4, edge=EDGE, boundary="dirichlet").columns(za, az)
    assert left(np.concatenate([known, constant])) < 0.1 * left(more) < 0.1 * left(known)


def test_next_modes_are_the_largest_that_are_missing() -> None:
    """Of a dipole over a dish: nearly as much power as in the best choice, and more than in the lowest orders."""
    full = FourierBessel.full(40, 20, edge=EDGE, boundary="neumann")
    pixels = beam_pixels(embedded_beam())
    coeffs = fit_basis(full, pixels).coeffs
    basis = select_largest(full, coeffs, 60)
    fit = fit_basis(basis, pixels)
    experiment = replace(small_experiment(), basis=basis, prior_mean=(fit.coeffs, fit.coeffs))
    power = dict(zip(full.modes, coeffs**2, strict=True))
    missing = [mode for mode in full.modes if mode not in set(basis.modes)]
    best = sum(sorted((power[mode] for mode in missing), reverse=True)[:60])
    lowest = sum(power[mode] for mode in sorted(missing, key=lambda mode: mode[0] + abs(mode[1]))[:60])
    modes = next_modes(experiment)
    assert 58 <= len(modes) <= 60
    assert len(set(modes)) == len(modes)
    found = sum(power.get(mode, 0.0) for mode in modes)
    assert found > 0.85 * best
    assert lowest < 0.6 * best


def test_there_is_always_more() -> None:
    """Also where the basis is a single mode, or has all modes of its orders."""
    for n_k, n_m, n in ((1, 0, 1), (40, 20, MOST_MODES), (1, 30, 61), (30, 0, 30)):
        basis = FourierBessel.full(n_k, n_m, edge=EDGE)
        experiment = replace(small_experiment(), basis=basis, prior_mean=(np.ones(basis.n_modes),) * 2)
        assert n - 1 <= len(next_modes(experiment)) <= n
    for degree, top in ((0, 1), (6, 9), (30, 33)):
        basis = Zernike(degree, EDGE)
        experiment = replace(small_experiment(), basis=basis, prior_mean=(np.ones(basis.n_modes),) * 2)
        assert BasisTruncation().amended_basis_settings(experiment) == {"max_degree": top}
        assert len(BasisTruncation().parameters(experiment)) == Zernike(top).n_modes - basis.n_modes
