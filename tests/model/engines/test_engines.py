"""Engines against the visibility sum written out term by term."""

import numpy as np
import pytest
from astropy.constants import c
from threadpoolctl import threadpool_limits

from hydrabeam_mpi.config.sections import Solver
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.engines import ENGINES, make_engine
from hydrabeam_mpi.model.engines.auto import AutoEngine
from hydrabeam_mpi.model.engines.fringes import Fringes, enu, find_lattice
from hydrabeam_mpi.model.engines.gemm import GemmEngine
from hydrabeam_mpi.model.engines.nufft import NufftEngine
from hydrabeam_mpi.random import generator

FREQS = np.array([100e6, 163.7e6])
HEX = np.array(
    [[14.6, 0, 0], [7.3, 14.6 * np.sqrt(3) / 2, 0], [29.2, 0, 0], [-7.3, 14.6 * np.sqrt(3) / 2, 0], [0, 0, 0]]
)


class Ripples:
    """Three smooth real functions of direction."""

    n_columns = 3

    def columns(self, za, az, out=None):
        values = np.stack([np.cos(za), np.sin(3 * az) * za, np.cos(za * 20)])
        return values if out is None else np.copyto(out, values) or out


def sources(n):
    rng = generator(0, "sources", n)
    return rng.uniform(0, np.pi / 2, n), rng.uniform(0, 2 * np.pi, n), rng.uniform(0.1, 10, (2, n))


def written_out(vectors, za, az, flux):
    s = np.array([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])
    columns = Ripples().columns(za, az)
    out = np.zeros((2, 2, len(vectors), 3))
    for f, freq in enumerate(FREQS):
        for u, vector in enumerate(vectors):
            for k in range(3):
                fringe = np.exp(2j * np.pi * freq * (vector @ s) / c.value)
                value = 0.5 * np.sum(flux[f] * columns[k] * fringe)
                out[f, 0, u, k], out[f, 1, u, k] = value.real, value.imag
    return out


def irregular(n=6, height=0.3):
    rng = generator(1, "vectors")
    return rng.uniform(-60, 60, (n, 3)) * [1, 1, height / 60]


@pytest.mark.parametrize("vectors", [HEX, irregular(), irregular(height=0.0)], ids=["hexagon", "3d", "coplanar"])
@pytest.mark.parametrize(
    "make", [GemmEngine, lambda v: GemmEngine(v, chunk=7), NufftEngine], ids=["gemm", "chunks", "nufft"]
)
@pytest.mark.parametrize("n", [0, 1, 50])
def test_engine_is_the_sum_over_sources(vectors, make, n):
    za, az, flux = sources(n)
    result = make(vectors).design(Ripples(), za, az, flux, FREQS)
    np.testing.assert_allclose(result, written_out(vectors, za, az, flux), atol=1e-10 * max(flux.sum(), 1))


@pytest.mark.parametrize("vectors", [HEX, irregular()], ids=["hexagon", "3d"])
def test_single_precision_has_the_phases_of_double(vectors):
    far = 100 * vectors  # thousands of turns
    za, az, flux = sources(3000)
    double = GemmEngine(far).design(Ripples(), za, az, flux, FREQS)
    single = GemmEngine(far).design(Ripples(), za, az, flux, FREQS, np.float32)
    assert single.dtype == np.float64
    # Phases in single precision would be wrong by 1e-4 of a radian.
    assert 0 < np.abs(single - double).max() < 4e-6 * np.linalg.norm(flux)


@pytest.mark.parametrize("vectors", [HEX, irregular()], ids=["hexagon", "3d"])
@pytest.mark.parametrize("make", ENGINES.values(), ids=ENGINES)
@pytest.mark.parametrize("n", [0, 1, 2100])
def test_responses_are_the_terms_of_the_sum_and_the_adjoint_is_theirs(vectors, make, n):
    za, az, flux = sources(n)
    engine, beam, freq = make(vectors), Ripples().columns(za, az)[2], FREQS[1]
    seen = engine.responses(enu(za, az), flux[1] * beam, freq)
    assert seen.shape == (len(vectors), n)
    expected = written_out(vectors, za, az, flux)[1, ..., 2]
    np.testing.assert_allclose(seen.sum(axis=1), expected[0] + 1j * expected[1], atol=1e-10 * max(flux.sum(), 1))
    rng = generator(2, "visibilities")
    vis = rng.standard_normal(len(vectors)) + 1j * rng.standard_normal(len(vectors))
    back = engine.adjoint(vis, enu(za, az), flux[1] * beam, freq)
    np.testing.assert_allclose(back, (seen.conj().T @ vis).real, atol=1e-10)


@pytest.mark.parametrize("name", ENGINES)
def test_a_job_can_ask_for_every_engine(name):
    assert type(make_engine(Solver(engine=name).engine, HEX)) is ENGINES[name]


def test_an_unknown_engine_is_told():
    with pytest.raises(InputError, match=r"'fft'.*gemm, nufft, auto"):
        make_engine("fft", HEX)


def test_both_engines_agree_to_a_billionth_on_many_sources():
    za, az, flux = sources(20000)
    vectors = np.concatenate([HEX, irregular()])
    one = GemmEngine(vectors).design(Ripples(), za, az, flux, FREQS)
    other = NufftEngine(vectors).design(Ripples(), za, az, flux, FREQS)
    assert np.abs(one - other).max() < 1e-9 * np.abs(one).max()


def test_ffts_are_chosen_for_many_vectors_of_a_lattice_alone():
    steps = np.array([[i, j] for i in range(-40, 41) for j in range(41)])
    many = steps @ HEX[:2]
    assert isinstance(AutoEngine(many).choose(5000, 1000), NufftEngine)
    assert isinstance(AutoEngine(many).choose(5000, 1000, np.float32), GemmEngine)
    assert isinstance(AutoEngine(many).choose(1, 1000), GemmEngine)
    assert isinstance(AutoEngine(HEX).choose(5000, 1000), GemmEngine)
    assert isinstance(AutoEngine(irregular(3000)).choose(5000, 1000), GemmEngine)
    za, az, flux = sources(100)
    one, other = (make(many).design(Ripples(), za, az, flux, FREQS) for make in (AutoEngine, GemmEngine))
    assert np.abs(one - other).max() < 1e-9 * np.abs(one).max()


def test_lattice_is_found_and_exact():
    lattice = find_lattice(HEX, 1e-7)
    assert lattice is not None
    np.testing.assert_allclose(lattice.index @ lattice.generators, HEX, atol=1e-12)


def test_no_lattice_where_there_is_none():
    assert find_lattice(irregular(), 1e-7) is None
    assert find_lattice(HEX + generator(0, "jitter").normal(size=HEX.shape) * 1e-3, 1e-7) is None
    assert find_lattice(np.array([[14.6, 0, 0], [29.2, 0, 0], [43.8, 0, 0]]), 1e-7) is None
    assert Fringes(np.zeros((0, 3))).lattice is None


def test_nufft_keeps_to_its_share_of_the_cores():
    with threadpool_limits(1):
        assert NufftEngine(HEX).threads == 1
    with threadpool_limits(2):
        assert NufftEngine(HEX).threads == 2


@pytest.mark.parametrize("n_rest", [0, 2])
def test_the_adjoint_by_antennas_is_that_by_vectors(n_rest):
    """Also of vectors that are no difference of two antennas' places."""
    rng = generator(3, "antennas")
    points = 50 * rng.standard_normal((7, 3))
    one, two = np.triu_indices(7, 1)
    vectors = np.concatenate([points[two] - points[one], 30 * rng.standard_normal((n_rest, 3))])
    za, az, flux = sources(2100)
    vis = rng.standard_normal(len(vectors)) + 1j * rng.standard_normal(len(vectors))
    by_antennas, by_vectors = make_engine("gemm", vectors, points), GemmEngine(vectors)
    assert by_antennas.fringes.pairs is not None
    told, expected = (one.adjoint(vis, enu(za, az), flux[1], FREQS[1]) for one in (by_antennas, by_vectors))
    np.testing.assert_allclose(told, expected, atol=1e-10 * flux.max())
