"""How beams differ from their models as a whole, against such beams."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.rings import Pixels, degree_grid
from hydrabeam_mpi.model.beam import Beam, BeamInfo, analytic_beam
from hydrabeam_mpi.model.fit import fit_basis
from hydrabeam_mpi.model.shape import AMPLITUDE, POINTING, SIDELOBE_LEVEL, SIDELOBES, SIZE, shape_of

MODEL = analytic_beam("airy", 131e6, "ee", diameter=14.0)
BASIS = FourierBessel([(k, m) for k in range(1, 41) for m in range(-4, 5)], form="real")


class Another:
    """A dish of another shape, as direction cosines of the model's."""

    info = BeamInfo("another", 131e6, "ee")

    def __init__(self, turn: FloatArray, tilt: tuple[float, float] = (0.0, 0.0), beam: Beam = MODEL) -> None:
        self.turn, self.tilt, self.beam = turn, np.array(tilt), beam

    def __call__(self, za: FloatArray, az: FloatArray) -> FloatArray:
        l = np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az)])
        east, north = self.turn @ l - self.tilt[:, np.newaxis]
        return self.beam(np.arcsin(np.minimum(np.hypot(east, north), 1)), np.arctan2(north, east))


def coefficients(beam: Beam) -> FloatArray:
    za, az = degree_grid()
    return fit_basis(BASIS, Pixels(za, az, beam(za, az))).coeffs


def size(*rows: tuple[float, float]) -> FloatArray:
    """The identity less this."""
    return np.eye(2) - np.array(rows)


S, P = 0.3 * SIZE, 0.3 * POINTING
CASES = {
    "larger from East to West": (0, Another(size((S, 0), (0, 0)))),
    "larger from North to South": (1, Another(size((0, 0), (0, S)))),
    "larger along the diagonal": (2, Another(size((0, S), (S, 0)))),
    "pointing East": (3, Another(np.eye(2), (P, 0))),
    "pointing North": (4, Another(np.eye(2), (0, P))),
}


@pytest.mark.parametrize("name", CASES)
def test_a_dish_of_another_shape_is_off_by_it(name: str) -> None:
    """To first order: of another size, or pointing elsewhere, by 0.3 of what is usual."""
    place, beam = CASES[name]
    changed = coefficients(beam) - coefficients(MODEL)
    left = changed - 0.3 * shape_of(MODEL, BASIS)[:, place]
    assert np.linalg.norm(left) < 0.05 * np.linalg.norm(changed)


def test_amplitude_and_sidelobes() -> None:
    found = shape_of(MODEL, BASIS)
    np.testing.assert_allclose(found[:, 5], AMPLITUDE * coefficients(MODEL), rtol=0, atol=1e-12)
    za, az = degree_grid()
    model = MODEL(za, az)
    in_sidelobes = BASIS.synthesize(found[:, 6], za, az)
    assert in_sidelobes == pytest.approx(SIDELOBES * model / (1 + model / SIDELOBE_LEVEL), abs=3e-4)
    by_azimuth = BASIS.synthesize(found[:, 9], za, az)
    assert by_azimuth == pytest.approx(in_sidelobes * np.cos(2 * az), abs=3e-4)
    # Of first order, five twice and in pairs, these in five sidelobes, and all but the amplitude at another one.
    assert found.shape == (BASIS.n_modes, 11 + 5 + 10 + 25 + 10)


class Louder:
    """Another beam with other sidelobes and another amplitude."""

    info = BeamInfo("another", 131e6, "ee")

    def __init__(self, beam: Beam, amplitude: float, sidelobes: float) -> None:
        self.beam, self.amplitude, self.sidelobes = beam, amplitude, sidelobes

    def __call__(self, za: FloatArray, az: FloatArray) -> FloatArray:
        power = self.beam(za, az)
        in_sidelobes = 1 / (1 + power / SIDELOBE_LEVEL)
        return (
            (1 + self.amplitude * AMPLITUDE) * power * (1 + self.sidelobes * SIDELOBES * in_sidelobes * np.cos(2 * az))
        )


def test_products_of_changes_are_what_is_left_of_large_ones() -> None:
    """To third order: of a beam that is off in many ways, by up to twice what is usual."""
    east, north, tilt, amplitude, sidelobes = -1.6, 0.8, 1.2, 1.0, -1.5
    moved = Another(size((east * SIZE, 0), (0, north * SIZE)), (tilt * POINTING, 0))
    first = np.zeros(11)
    first[[0, 1, 3, 5, 9]] = east, north, tilt, amplitude, sidelobes
    moves, of_sidelobes = first[:5], first[6:]
    products = np.concatenate([
        moves**2 / np.sqrt(3),
        [moves[i] * moves[j] for i in range(5) for j in range(i + 1, 5)],
        np.outer(of_sidelobes, moves).ravel(),
        amplitude * np.append(moves, of_sidelobes),
    ])  # fmt: skip
    changed = coefficients(Louder(moved, amplitude, sidelobes)) - coefficients(MODEL)
    found = shape_of(MODEL, BASIS)
    by_first = np.linalg.norm(changed - found[:, :11] @ first)
    by_both = np.linalg.norm(changed - found @ np.concatenate([first, products]))
    assert by_first > 0.1 * np.linalg.norm(changed)
    assert by_both < 0.2 * by_first


def test_products_that_do_nothing_are_left_out() -> None:
    """A basis of round functions has nothing of what varies with azimuth."""
    basis = FourierBessel([(k, 0) for k in range(1, 25)], form="real")
    found = shape_of(MODEL, basis)
    assert found.shape[1] < 61
    assert np.all(np.linalg.norm(found[:, 11:], axis=0) > 1e-6 * np.linalg.norm(found[:, 5]))
