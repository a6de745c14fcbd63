import numpy as np
import pytest

from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.random import generator


@pytest.mark.parametrize("form", ["real", "complex"])
@pytest.mark.parametrize(("k_max", "m_max", "edge"), [(1, 0, 90.0), (20, 8, 92.0), (60, 30, 120.0)])
def test_a_table_has_the_beam_and_its_slopes(form: str, k_max: int, m_max: int, edge: float) -> None:
    """All modes alike, of which the highest are the least exact; at zenith, horizon and cut as well."""
    _check_table(FourierBessel.full(k_max, m_max, form=form, edge=np.deg2rad(edge)))


@pytest.mark.parametrize(("degree", "edge"), [(0, 90.0), (1, 92.0), (15, 90.0), (20, 92.0), (32, 120.0)])
def test_a_table_of_polynomials_goes_on_through_the_zenith(degree: int, edge: float) -> None:
    """Those of odd azimuthal order change sign there."""
    _check_table(Zernike(degree, np.deg2rad(edge)))


def test_polynomials_that_end_above_the_horizon_have_no_table() -> None:
    assert Zernike(4, np.deg2rad(80.0)).table(np.ones(15)) is None


def _check_table(basis: LinearBasis) -> None:
    rng = generator(4, "table")
    coeffs = rng.standard_normal(basis.n_modes)
    coeffs = coeffs + 1j * rng.standard_normal(basis.n_modes) if basis.is_complex else coeffs
    za, az = np.arccos(rng.uniform(0.0, 1.0, 300)), rng.uniform(0.0, 2 * np.pi, 300)
    za[:3], az[3:5] = (0.0, np.pi / 2, np.pi / 2 - 1e-9), (0.0, 2 * np.pi)
    table = basis.table(coeffs)
    assert table is not None

    def beam(more_za: float = 0.0, more_az: float = 0.0) -> np.ndarray:
        return np.asarray(basis.synthesize(coeffs, za + more_za, az + more_az)).real

    assert np.abs(table(za, az) - beam()).max() < 1e-6 * np.abs(beam()).max()
    step = 2e-6
    inside = (za > step) & (za < np.pi / 2)
    expected = (beam(step) - beam(-step)) / (2 * step), (beam(0.0, step) - beam(0.0, -step)) / (2 * step)
    for found, numerical in zip(table.with_slopes(za, az)[1:], expected, strict=True):
        assert np.abs(found - numerical)[inside].max() < 5e-6 * np.abs(numerical[inside]).max() + 1e-9
