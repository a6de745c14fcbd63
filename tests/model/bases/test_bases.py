"""The contract that every basis keeps."""

import json

import numpy as np
import pytest
from astropy_healpix import HEALPix

from hydrabeam_mpi.config.sections import Basis
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases import BASES as REGISTRY
from hydrabeam_mpi.model.bases import JOB_NAMES, basis_from_description, basis_from_settings
from hydrabeam_mpi.model.bases.base import LinearBasis, Selection
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.healpix_map import HealpixMap
from hydrabeam_mpi.model.bases.joined import Joined
from hydrabeam_mpi.model.bases.rest import Rest, rest_nodes
from hydrabeam_mpi.model.bases.turned import Turned
from hydrabeam_mpi.model.bases.with_rest import WithRest
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.random import generator


class Cosines(LinearBasis):
    """Powers of cos za: a basis plugged in with nothing but its functions."""

    n_modes = n_columns = 4
    is_complex = False

    def columns(self, za, az, out=None):
        columns = np.cos(za) ** np.arange(4)[:, None]
        if out is None:
            return columns
        out[...] = columns
        return out

    def describe(self):
        return {"kind": "cosines"}


def scrambled(form, **settings):
    """Some modes of all kinds in no order, in complex form one of them without its partner."""
    modes = FourierBessel.full(9, 5).modes[: -1 if form == "complex" else None]
    order = generator(3, form).permutation(len(modes))
    return FourierBessel([modes[n] for n in order], form=form, **settings)


def ripple(za, az):
    return np.sin(za) ** 2 * np.cos(2 * az) + np.cos(9 * za)


def coarse_map():
    """A HEALPix map of a few hundred pixels of the sky."""
    longitude, latitude = HEALPix(8).healpix_to_lonlat(np.arange(768))
    values = ripple(np.pi / 2 - latitude.rad, longitude.rad)
    return HealpixMap(8, "ring", np.arange(768), values).times(0.5)


BASES = {
    "real": FourierBessel.full(12, 7, form="real"),
    "complex": FourierBessel.full(12, 7, form="complex"),
    "real, scrambled": scrambled("real"),
    "complex, scrambled": scrambled("complex", boundary="neumann"),
    "real, Neumann": FourierBessel.full(7, 3, form="real", boundary="neumann", edge=np.deg2rad(100)),
    "one mode": FourierBessel([(1, 0)], form="real", n_az=1),
    "one complex mode": FourierBessel([(3, -2)], form="complex"),
    "horizon inside the disc": FourierBessel.full(5, 2, form="complex", edge=np.deg2rad(60)),
    "Zernike": Zernike(7),
    "Zernike 0": Zernike(0),
    "joined": Joined([FourierBessel.full(4, 3), Zernike(5)], [40, 2, 5, 30, 29, 1]),
    "joined twice": Joined([Joined([Zernike(3), Zernike(4)], [20, 0, 3]), FourierBessel.full(2, 3)]),
    "joined, complex": Joined([scrambled("complex"), FourierBessel.full(3, 2)]),
    "turned": Turned(FourierBessel.full(7, 3, form="real"), 0.7),
    "turned, complex": Turned(scrambled("complex"), -np.pi / 2),
    "turned and joined": Joined([Turned(Zernike(3), 1.0), Turned(Zernike(4), 1.0)], [20, 0, 3]),
    "with rest": WithRest(FourierBessel.full(7, 3, form="real"), Rest(ripple(*rest_nodes()))),
    "with rest, complex": WithRest(scrambled("complex"), Rest(ripple(*rest_nodes()))),
    "rest": Rest(ripple(*rest_nodes())),
    "rest of a map": Rest(ripple(*rest_nodes()), coarse_map()),
    "with rest of a map": WithRest(FourierBessel.full(7, 3, form="real"), Rest(ripple(*rest_nodes()), coarse_map())),
    "joined with a rest": Joined([FourierBessel.full(7, 3, form="real"), Rest(ripple(*rest_nodes()))]),
    "plugged in": Cosines(),
}


@pytest.fixture(params=list(BASES))
def basis(request):
    return BASES[request.param]


def points(n, *key):
    rng = generator(1, "points", n, *key)
    return np.arccos(rng.uniform(0, 1, n)), rng.uniform(-7, 7, n)


def coefficients(basis, *key):
    rng = generator(2, "coefficients", *key)
    real = rng.standard_normal(basis.n_modes)
    return real + 1j * rng.standard_normal(basis.n_modes) if basis.is_complex else real


def test_columns_are_real_and_in_rows(basis):
    columns = basis.columns(*points(11))
    assert columns.shape == (basis.n_columns, 11)
    assert columns.dtype == np.float64
    assert columns.flags.c_contiguous


def test_columns_mix_to_functions(basis):
    za, az = points(11)
    functions = basis.evaluate(za, az)
    assert functions.shape == (basis.n_modes, 11)
    assert np.iscomplexobj(functions) == basis.is_complex
    np.testing.assert_array_equal(basis.mix(basis.columns(za, az).T).T, functions)


def test_mix_commutes_with_products_from_the_left(basis):
    columns = basis.columns(*points(11)).T
    rows = generator(5, "rows").standard_normal((2, 3, 11)) * (1 + 2j)
    mixed = basis.mix(rows @ columns)
    assert mixed.shape == (2, 3, basis.n_modes)
    np.testing.assert_allclose(mixed, rows @ basis.mix(columns), rtol=1e-12, atol=1e-13)


def test_coefficients_of_columns_give_the_same_beam(basis):
    za, az = points(11)
    coeffs = np.stack([coefficients(basis, 1), coefficients(basis, 2)])
    folded = basis.column_coeffs(coeffs)
    assert folded.shape == (2, basis.n_columns)
    np.testing.assert_allclose(folded @ basis.columns(za, az), coeffs @ basis.evaluate(za, az), atol=1e-12)


@pytest.mark.parametrize("n", [0, 1, 2048, 2100])
def test_synthesis_is_the_sum_of_functions(basis, n):
    za, az = points(n)
    coeffs = coefficients(basis)
    values = basis.synthesize(coeffs, za, az)
    assert np.iscomplexobj(values) == basis.is_complex
    np.testing.assert_allclose(values, coeffs @ basis.evaluate(za, az), rtol=1e-12, atol=1e-12)


def test_points_do_not_influence_each_other(basis):
    za, az = points(2100)
    everything = basis.columns(za, az)
    np.testing.assert_allclose(basis.columns(za[2000:2003], az[2000:2003]), everything[:, 2000:2003], atol=1e-13)


def test_result_is_written_where_asked(basis):
    za, az = points(5)
    room = np.full((basis.n_columns, 9), np.nan)
    assert basis.columns(za, az, out=room[:, 2:7]).base is room
    np.testing.assert_array_equal(room[:, 2:7], basis.columns(za, az))
    assert np.isnan(room[:, :2]).all()
    assert np.isnan(room[:, 7:]).all()


def test_later_calls_leave_earlier_results_alone(basis):
    za, az = points(7)
    first = basis.columns(za, az)
    kept = first.copy()
    basis.columns(*points(7, "other"))
    basis.synthesize(coefficients(basis), *points(70))
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(basis.columns(za, az), kept)


def test_zenith_horizon_and_full_turns(basis):
    za = np.array([0.0, 1e-12, np.pi / 2, np.pi / 2])
    az = np.array([0.0, 0.0, 1.0, 1.0 + 2 * np.pi])
    functions = basis.evaluate(za, az)
    assert np.isfinite(functions).all()
    np.testing.assert_allclose(functions[:, 0], functions[:, 1], atol=1e-9)
    np.testing.assert_allclose(functions[:, 2], functions[:, 3], atol=1e-12)


def test_what_is_turned_has_the_values_of_another_azimuth():
    """A function of the feed that points North has towards North what that of the other one has towards East."""
    basis, za = FourierBessel.full(7, 3, form="real"), np.linspace(0.1, 1.5, 5)
    north = Turned(basis, np.pi / 2).evaluate(za, np.full(5, np.pi / 2))
    np.testing.assert_allclose(north, basis.evaluate(za, np.zeros(5)), atol=1e-12)


def test_amplitudes_are_sizes_of_coefficients(basis):
    amplitudes = basis.amplitudes(coefficients(basis))
    assert amplitudes.shape == (basis.n_modes,)
    assert (amplitudes > 0).all()
    assert np.sum(amplitudes**2) == pytest.approx(np.sum(np.abs(coefficients(basis)) ** 2))


def test_the_contract_is_kept_by_every_basis_there_is():
    assert {type(basis) for basis in BASES.values()} - {Cosines} == set(REGISTRY.values())


def test_a_basis_of_which_nothing_more_is_known():
    basis = Cosines()
    assert basis.next_modes(np.ones(4), 0, 4) is None
    assert basis.largest(np.ones(4), 2) is basis


FIFTEEN = {"fourier-bessel": {"n_modes": 9, "k_max": 3, "m_max": 2}, "zernike": {"max_degree": 4}}
"""Keys with which a job asks for 15 functions of each kind, from which it may select."""


@pytest.mark.parametrize("name", JOB_NAMES)
def test_a_job_can_ask_for_every_basis(name):
    settings = Basis(kind=name, edge="95 deg", **FIFTEEN[name])
    made = basis_from_settings(settings.model_dump())
    basis = made.basis if isinstance(made, Selection) else made
    assert basis.n_modes == 15
    assert basis.describe()["edge"] == np.deg2rad(95)
    assert JOB_NAMES[name] == basis.describe()["kind"]
    assert type(basis) is REGISTRY[JOB_NAMES[name]]


def test_what_is_joined_is_no_basis_to_begin_with():
    with pytest.raises(InputError, match="one of its parts"):
        Joined.from_settings({})


def test_an_unknown_basis_is_told():
    with pytest.raises(InputError, match=r"wavelets.*fourier-bessel, zernike"):
        basis_from_settings({"kind": "wavelets"})


@pytest.mark.parametrize("name", [name for name in BASES if name != "plugged in"])
def test_description_restores_the_basis(name):
    basis = BASES[name]
    restored = basis_from_description(json.loads(json.dumps(basis.describe())))
    assert type(restored) is type(basis)
    assert restored.describe() == basis.describe()
    np.testing.assert_array_equal(restored.evaluate(*points(9)), basis.evaluate(*points(9)))


ZERNIKE = {"kind": "zernike", "degree": 1, "edge": 1.6}


@pytest.mark.parametrize(
    ("description", "words"),
    [
        ({"kind": "wavelets"}, "wavelets.*fourier_bessel"),
        ({}, "None"),
        ({"kind": "zernike"}, "degree"),
        ({"kind": "fourier_bessel", "modes": [[1, 0]]}, "form"),
        ({"kind": "joined", "parts": [{"kind": "zernike"}], "kept": [0]}, "degree"),
        ({"kind": "joined", "parts": [ZERNIKE], "kept": [3]}, "do not have"),
        ({"kind": "joined", "parts": [ZERNIKE], "kept": [1, 1]}, "do not have"),
        ({"kind": "joined", "parts": [ZERNIKE], "kept": []}, "do not have"),
        ({"kind": "with_rest", "parts": [ZERNIKE], "values": "AAAA"}, "buffer size"),
        ({"kind": "with_rest", "parts": [ZERNIKE], "values": "AAAAAA=="}, "each node"),
        (BASES["rest of a map"].describe() | {"samples": {"nside": 4, "ordering": "ring", "values": ""}}, "each pixel"),
        (BASES["rest of a map"].describe() | {"samples": {"nside": 4, "ordering": "ring"}}, "values"),
        ({"kind": "joined", "parts": [3], "kept": [0]}, "incomplete"),
        ({"kind": "joined", "parts": [], "kept": [0]}, "do not have"),
    ],
)
def test_bad_description_is_told(description, words):
    with pytest.raises(InputError, match=words):
        basis_from_description(description)
