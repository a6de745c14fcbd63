"""Images of what is left at single times."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from hydrabeam_mpi.data.observation import C_M_PER_S
from hydrabeam_mpi.loop.residuals.coherent import SPOTS, WANDERING_SPOTS, Coherence
from hydrabeam_mpi.loop.residuals.localise import where
from hydrabeam_mpi.loop.residuals.transients import MOST_DIRECTIONS, TransientSums, transients
from hydrabeam_mpi.random import complex_normal, generator
from tests.loop.white import make_layout, noise, sums_of

LAYOUT = make_layout(n_freqs=2)
VECTORS, MEMBER = LAYOUT.redundant.vectors, LAYOUT.redundant.group
FREQS = LAYOUT.observation.freqs
N_TIMES = LAYOUT.observation.Ntimes
ROOT = generator(2, "root").uniform(0.5, 2, (N_TIMES, len(MEMBER)))


def white(seed: int) -> np.ndarray:
    return np.sqrt(2) * complex_normal(generator(seed, "spots"), (2, N_TIMES, len(MEMBER)))


def source(flux: np.ndarray, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Return whitened visibilities of a source with a place and a flux at each time."""
    places = np.stack([east, north, np.sqrt(1 - east**2 - north**2)])
    phase = 2 * np.pi / C_M_PER_S * FREQS[:, np.newaxis, np.newaxis] * (VECTORS @ places).T
    return ROOT * flux[:, np.newaxis] * np.exp(1j * phase)[..., MEMBER]


def found_in(z: np.ndarray) -> dict[str, Coherence]:
    sums = TransientSums.zeros(N_TIMES, VECTORS, float(FREQS.max()))
    for f, freq in enumerate(FREQS.tolist()):
        sums.add(np.arange(N_TIMES), z[f], ROOT, VECTORS, MEMBER, freq)
    return {one.name: one for one in transients(sums.reduce(MPI.COMM_SELF))}


def test_noise_has_no_spots() -> None:
    """Probabilities are those of the largest of many directions, of which there are fewer than are looked at."""
    sigmas = [[one.sigma().max() for one in found_in(white(seed)).values()] for seed in range(40)]
    single, together = np.array(sigmas).T
    assert single.max() < 4.5  # the largest of 60 times in each of 40 draws
    assert together.max() < 2.5


def test_a_source_that_moves_is_found_at_its_times() -> None:
    flux = np.zeros(N_TIMES)
    flux[20:32] = 0.7
    along = np.linspace(-0.5, 0.5, N_TIMES)
    found = found_in(white(1) + source(flux, along, 0.3 - along))
    assert found[WANDERING_SPOTS].sigma()[0] > 8
    brightest = found[SPOTS].index[np.argsort(-found[SPOTS].chi2)[:8]]
    assert np.all((brightest >= 20) & (brightest < 32))
    told = where(sums_of(LAYOUT, noise(LAYOUT)), LAYOUT, 0.0, tuple(found.values()))["times"]
    jds = LAYOUT.observation.times
    assert told["state"] != "even"
    assert all(jds[20] <= entry["what"]["jd"] <= jds[31] for entry in told["entries"][:3])


def test_a_spot_is_where_it_is() -> None:
    """Noise apart, the filter of the right direction gives the flux times the weight, and no other gives more."""
    sums = TransientSums.zeros(N_TIMES, VECTORS, float(FREQS.max()))
    k = len(sums.directions) // 3
    east, north = (np.full(N_TIMES, cosine) for cosine in sums.directions[k, :2])
    z = source(np.full(N_TIMES, 0.7), east, north)
    sums.add(np.arange(N_TIMES), z[0], ROOT, VECTORS, MEMBER, float(FREQS[0]))
    np.testing.assert_allclose(sums.image[:, k], 0.7 * sums.weight, rtol=1e-10)
    assert np.all(sums.image[:, k] >= (1 - 1e-10) * sums.image.max(axis=1))


def test_long_baselines_do_not_ask_for_more_directions_than_there_may_be() -> None:
    sums = TransientSums.zeros(10, np.array([[3000.0, 0, 0], [20.0, 5, 0]]), 150e6)
    assert len(sums.directions) < 1.2 * MOST_DIRECTIONS
    assert 50 < sums.longest < 3000
    z = np.ones((10, 2), dtype=complex)
    sums.add(np.arange(10), z, np.ones((10, 2)), np.array([[3000.0, 0, 0], [20.0, 5, 0]]), np.arange(2), 150e6)
    np.testing.assert_array_equal(sums.weight, 1.0)  # of the short one alone


def test_nothing_is_said_without_data() -> None:
    assert list(transients(TransientSums.zeros(3, VECTORS, float(FREQS.max())))) == []
