"""Which functions a basis would have next."""

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.model.fit import beam_pixels, fit_basis, fit_beam
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.tables import embedded_beam

EDGE = np.deg2rad(92)


def amplitudes_in(basis: LinearBasis) -> FloatArray:
    """Sizes of the coefficients of a dipole over a dish."""
    return basis.amplitudes(fit_beam(embedded_beam(), basis).coeffs)


def test_a_beam_that_is_not_zero_at_the_edge_needs_few_more_modes() -> None:
    basis = FourierBessel.full(20, 4, edge=EDGE, boundary="dirichlet")
    modes = basis.next_modes(amplitudes_in(basis), 0, basis.n_modes).modes
    assert modes[:9] == ((0, 0), *((0, sign * m) for m in range(1, 5) for sign in (1, -1)))
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
    basis = full.largest(full.amplitudes(coeffs), 60)
    power = dict(zip(full.modes, coeffs**2, strict=True))
    missing = [mode for mode in full.modes if mode not in set(basis.modes)]
    best = sum(sorted((power[mode] for mode in missing), reverse=True)[:60])
    lowest = sum(power[mode] for mode in sorted(missing, key=lambda mode: mode[0] + abs(mode[1]))[:60])
    modes = basis.next_modes(amplitudes_in(basis), 0, 60).modes
    assert 58 <= len(modes) <= 60
    assert len(set(modes)) == len(modes)
    found = sum(power.get(mode, 0.0) for mode in modes)
    assert found > 0.85 * best
    assert lowest < 0.6 * best


def test_there_is_always_more() -> None:
    """Also where the basis is a single mode, or has all modes of its orders."""
    for n_k, n_m, n in ((1, 0, 1), (40, 20, 128), (1, 30, 61), (30, 0, 30)):
        basis = FourierBessel.full(n_k, n_m, edge=EDGE)
        assert n - 1 <= len(basis.next_modes(np.ones(basis.n_modes), 0, min(128, basis.n_modes)).modes) <= n
    for degree, top in ((0, 1), (6, 9), (30, 33)):
        basis = Zernike(degree, EDGE)
        following = basis.next_modes(np.ones(basis.n_modes), 0, min(128, basis.n_modes))
        assert following.modes[-1] == (top, top)
        assert len(following.modes) == Zernike(top).n_modes - basis.n_modes


@pytest.mark.parametrize("n_modes", [60, 61])
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_later_modes_go_on_where_earlier_ones_end(boundary, n_modes) -> None:
    """No mode comes twice, and none of a pair m, -m is left out, whatever is cut off a call's end."""
    full = FourierBessel.full(20, 8, edge=EDGE, boundary=boundary)
    basis = full.largest(full.amplitudes(fit_beam(embedded_beam(), full).coeffs), n_modes)
    every = list(basis.modes)
    for _ in range(4):
        following = basis.next_modes(amplitudes_in(basis), len(every) - basis.n_modes, basis.n_modes)
        every += following.modes
        assert len(every) == len(set(every))
    assert all((k, -m) in every for k, m in every)


def test_next_functions_are_columns_of_a_larger_basis() -> None:
    za, az = generator(4, "directions").uniform(0, 1, (2, 50)) * np.array([[EDGE], [2 * np.pi]])
    basis = FourierBessel.full(4, 3, form="complex", edge=EDGE)
    following = basis.next_modes(np.ones(basis.n_modes), 7, 20)
    assert all(k > 0 for k, _ in following.modes)
    np.testing.assert_array_equal(
        following.basis.evaluate(za, az), FourierBessel(following.modes, "real", EDGE).columns(za, az)
    )
    following = Zernike(3, EDGE).next_modes(np.ones(10), 5, 10)
    assert following.modes[0] == (5, -5)
    larger = Zernike(following.modes[-1][0], EDGE)
    np.testing.assert_array_equal(following.basis.evaluate(za, az), larger.columns(za, az)[15:])


def test_what_a_symmetric_model_lacks_is_expected_by_its_neighbours_not_by_its_smallest_coefficients() -> None:
    """A model beam that is even under half a turn, with coefficients down to rounding; the true one leans a little."""
    full = FourierBessel.full(40, 12, edge=EDGE, boundary="neumann")
    amplitudes = amplitudes_in(full)
    odd = np.array([m % 2 == 1 for _, m in full.modes])
    even = full.with_modes([mode for mode, is_odd in zip(full.modes, odd, strict=True) if not is_odd])
    following = even.next_modes(np.maximum(amplitudes[~odd], 1e-8), 0, 60)
    true = dict(zip(full.modes, amplitudes, strict=True))
    ratios = np.array([true[mode] for mode in following.modes]) / following.expected
    assert following.expected.min() > 1e-6
    assert 0.05 < np.median(ratios) < 20
