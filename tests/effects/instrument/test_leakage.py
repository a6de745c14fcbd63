from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.instrument.leakage import Leakage
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_setup

ALL = replace(small_setup(), file_pols=("ee", "nn", "en", "ne"))


def test_what_files_lack_is_said() -> None:
    check = Leakage()
    assert check.not_applicable(ALL) is None
    assert check.not_applicable(replace(ALL, file_pols=("xx", "yy", "yx"))) is None
    for pols in (("ee",), ("ee", "nn"), ("ee", "en", "ne"), ("xx", "nn", "en")):
        not_applicable = check.not_applicable(replace(ALL, file_pols=pols))
        assert not_applicable is not None
        assert ", ".join(pols) in not_applicable


def test_columns_are_those_of_leaking_feeds() -> None:
    """Voltages of two feeds an antenna, leaked and multiplied: the part of first order."""
    numbers = ALL.observation.antenna_numbers.tolist()
    pairs = np.array([[numbers.index(ant) for ant in pair] for pair in ALL.observation.antpairs.tolist()])
    rng = generator(1, "leakage")
    n_times, n_ants = 3, len(numbers)
    x = 1e-6 * rng.standard_normal(4 * n_ants)
    d = (x[0::2] + 1j * x[1::2]).reshape(n_ants, 2)
    ee, nn = complex_normal(rng, (n_times, len(pairs))), complex_normal(rng, (n_times, len(pairs)))
    for pol, feed in (("en", 0), ("ne", 1)):
        vis = np.empty((n_times, len(pairs)), dtype=complex)
        for row, (i, j) in enumerate(pairs):
            for t in range(n_times):
                coherency = np.diag([ee[t, row], nn[t, row]])
                jones = [np.array([[1, d[ant, 0]], [d[ant, 1], 1]]) for ant in (i, j)]
                vis[t, row] = (jones[0] @ coherency @ jones[1].conj().T)[feed, 1 - feed]
        columns = Leakage().columns(ALL, pol, np.arange(len(pairs)), {"ee": ee, "nn": nn})
        np.testing.assert_allclose(columns.apply(x), vis, rtol=0, atol=1e-10)
    assert len(Leakage().parameters(ALL)) == len(x)
    assert Leakage().parameters(ALL).names[2] == f"antenna {numbers[0]} feed n leakage, real part"


def leaked(d: np.ndarray, ee: np.ndarray, nn: np.ndarray) -> dict[str, np.ndarray]:
    """Return all products of D-terms (Nants, 2) and visibilities (Ntimes, Nbls) of an unpolarised sky."""
    i, j = ALL.antenna_index.T
    flipped = ALL.redundant.flipped
    i, j = np.where(flipped, j, i), np.where(flipped, i, j)
    return {
        "ee": ee + d[i, 0] * d[j, 0].conj() * nn,
        "nn": nn + d[i, 1] * d[j, 1].conj() * ee,
        "en": d[i, 0] * nn + d[j, 1].conj() * ee,
        "ne": d[i, 1] * ee + d[j, 0].conj() * nn,
    }


def test_strong_leakage_is_exact_once_it_is_taken_from_the_copols() -> None:
    rng = generator(2, "leakage")
    n_ants, n_bls = ALL.observation.Nants, ALL.observation.Nbls
    x = 0.2 * rng.standard_normal(4 * n_ants)
    ee, nn = complex_normal(rng, (3, n_bls)), complex_normal(rng, (3, n_bls))
    found = leaked((x[0::2] + 1j * x[1::2]).reshape(n_ants, 2), ee, nn)
    check, bls = Leakage(), np.arange(n_bls)
    copols = check.without(ALL, bls, found, x)
    np.testing.assert_allclose(copols["ee"], ee, rtol=0, atol=1e-12)
    np.testing.assert_allclose(copols["nn"], nn, rtol=0, atol=1e-12)
    for pol in ("en", "ne"):
        np.testing.assert_allclose(check.columns(ALL, pol, bls, copols).apply(x), found[pol], rtol=0, atol=1e-12)


def test_equal_feeds_do_not_tell_what_antennas_have_in_common() -> None:
    rng = generator(3, "leakage")
    vis = complex_normal(rng, (3, ALL.observation.Nbls))
    check = Leakage()
    for x in check.degenerate_directions(ALL):
        for pol in ("en", "ne"):
            columns = check.columns(ALL, pol, np.arange(ALL.observation.Nbls), {"ee": vis, "nn": vis})
            np.testing.assert_allclose(columns.apply(x), 0, atol=1e-14)
