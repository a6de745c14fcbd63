"""Simulation-based calibration: truths drawn from the prior must look like draws from their own posteriors.

If prior, forward model, noise and algebra are consistent, then the rank of a true coefficient among posterior draws is
uniform, (x - mean)^H P (x - mean) follows a chi^2 distribution, and held-out data are standard normal about the
posterior predictive. Seeds are fixed; a right program fails one of these tests for one seed in a thousand. Each of
them is also shown to fail when the noise variance is stated wrong by a factor of two.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from astropy.coordinates import EarthLocation
from scipy.stats import chi2, chisquare, kstest, norm

from hydrabeam_mpi.data.observation import Observation, Visibilities
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.fit.accumulate import accumulate, check_heldout
from hydrabeam_mpi.fit.equations import BEAM
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.inference.predictive_checks import Z_EDGES
from hydrabeam_mpi.inference.prior import DiagonalPrior
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.engines import make_engine
from hydrabeam_mpi.model.positions import RotatedPositions
from hydrabeam_mpi.model.rime import ForwardModel
from hydrabeam_mpi.model.sky import mock_sky
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.simulation.arrays import hexagon

N_MOCKS = 600
N_DRAWS = 63
N_BINS = 8
MODES = [(k, m) for k in (1, 2, 3) for m in (0, 1, -1, 2, -2)]
FREQ = np.array([131e6])
TRAIN, TEST = np.arange(4), np.arange(4, 6)
SIGMA = 1.0  # Jy
CHANCE, HOPELESS = 1e-3, 1e-6


def observe():
    layout = hexagon(2, 3, 14.6)
    one, two = np.triu_indices(7, 1)
    return Observation(
        telescope_name="made",
        location=EarthLocation.from_geodetic(lon=21.4283, lat=-30.7215, height=1051.69),
        antenna_numbers=layout.numbers,
        antenna_names=layout.names,
        antpos=layout.antpos,
        antpairs=np.stack([one, two], axis=1),
        freqs=FREQ,
        channel_width=np.full(1, 1e5),
        times=2459866.0 + np.arange(6) / 24,
        lsts=np.linspace(0, 6, 6),
        integration_time=np.full(6, 10.0),
        pols=("ee",),
    )


@dataclass(frozen=True)
class Calibration:
    """What the mocks gave.

    Attributes
    ----------
    ranks : ndarray of int, (N_MOCKS, Nnumbers)
        Of each true coefficient among N_DRAWS draws; of real and imaginary part where coefficients are complex.
    distances : ndarray, (N_MOCKS,)
        Squared Mahalanobis distance of the truth from the posterior mean, for real numbers.
    z_counts : ndarray, (Nbins,)
        Held-out z-scores of one visibility a mock, over `Z_EDGES`.
    """

    ranks: np.ndarray
    distances: np.ndarray
    z_counts: np.ndarray


class ObservingSetup:
    """A small array, ready to observe one beam after another."""

    def __init__(self, form):
        observation = observe()
        sky = mock_sky(1, FREQ, n_sources=60)
        self.basis = FourierBessel(MODES, form)
        self.redundant = find_redundant_groups(observation.bl_vectors, 1e-7)
        engine = make_engine("gemm", self.redundant.vectors)
        self.model = ForwardModel(RotatedPositions(sky, observation), sky.flux, FREQ, engine)
        rng = generator(1, "experiment", form)
        # The data narrow some coefficients to a few per cent of the prior, others to two thirds of it.
        self.prior = DiagonalPrior(self.white(rng), np.geomspace(1, 0.1, len(MODES)))
        shape = (1, 6, observation.Nbls)
        self.sigma = SIGMA * rng.uniform(0.5, 2, shape)
        self.flags = rng.random(shape) < 0.05

    def white(self, rng):
        """Draw coefficients of unit variance."""
        return complex_normal(rng, (len(MODES),)) if self.basis.is_complex else rng.standard_normal(len(MODES))

    def observe(self, coeffs, rng):
        """Simulate all baselines as the array sees them, with noise, and nonsense where flagged."""
        unique = self.model.visibilities([lambda za, az: self.basis.synthesize(coeffs, za, az)], np.arange(6))
        data = unique[:, :, self.redundant.group]
        data = np.where(self.redundant.flipped, data.conj(), data)
        return np.where(self.flags, 1e6, data + self.sigma * complex_normal(rng, data.shape))

    def rows(self, times, data, inv_noise_var):
        tile = Tile(times, np.arange(data.shape[2]))
        chosen = Visibilities(data[:, times, :, np.newaxis], inv_noise_var[:, times, :, np.newaxis])
        return Rows.of(tile, chosen, self.redundant, chosen.data.size)

    def mock(self, number, stated):
        """Draw a truth, observe it, infer it; the noise variance is stated as ``stated`` times what it is."""
        rng = generator(2, "mock", number)
        truth = self.prior.mean + self.prior.sigma * self.white(rng)
        data = self.observe(truth, rng)
        weights = np.where(self.flags, 0, 1 / (stated * self.sigma**2))
        (normal,) = accumulate(self.rows(TRAIN, data, weights), self.model, self.basis)
        posterior = normal.gaussian({BEAM: self.prior}).solve()
        draws = np.array([posterior.draw(rng) for _ in range(N_DRAWS)])
        ranks = (as_real(draws) < as_real(truth)).sum(axis=0)
        white = as_real(posterior.factor.conj().T @ (truth - posterior.mean))
        # Parts of a complex number of unit variance have a variance of one half.
        distance = np.sum(white**2) * (2 if self.basis.is_complex else 1)

        # One visibility a mock: those of one mock share the posterior, so that their z-scores are not independent.
        only = np.zeros_like(weights)
        place = (0, rng.choice(TEST), rng.integers(weights.shape[2]))
        only[place] = weights[place]
        beams = [lambda za, az: self.basis.synthesize(self.prior.mean, za, az)]
        rows = self.rows(TEST, data, only)
        (heldout,) = check_heldout(rows, self.model, self.basis, [posterior], beams)
        return ranks, distance, heldout.counts[0]


def as_real(values):
    """Put real and imaginary parts side by side."""
    return np.concatenate([values.real, values.imag], axis=-1) if np.iscomplexobj(values) else values


@cache
def calibrate(form, stated=1.0):
    setup = ObservingSetup(form)
    ranks, distances, counts = zip(*(setup.mock(number, stated) for number in range(N_MOCKS)), strict=True)
    return Calibration(np.array(ranks), np.array(distances), np.sum(counts, axis=0))


def p_of_ranks(calibration):
    """Probability of the least uniform of the rank histograms, times their number."""
    bins = calibration.ranks * N_BINS // (N_DRAWS + 1)
    p_values = [chisquare(np.bincount(column, minlength=N_BINS)).pvalue for column in bins.T]
    return min(p_values) * len(p_values)


def p_of_distances(calibration):
    """Probability of the largest deviation from chi^2 with as many degrees of freedom as real numbers."""
    return kstest(calibration.distances, chi2(calibration.ranks.shape[1]).cdf).pvalue


def p_of_heldout(calibration):
    """Probability of the histogram of z-scores, in bins that a standard normal fills with one in sixteen or more."""
    edges = [0, *np.searchsorted(Z_EDGES, norm.ppf(np.arange(1, 16) / 16)), len(Z_EDGES) - 1]
    found = np.add.reduceat(calibration.z_counts, edges[:-1])
    return chisquare(found, found.sum() * np.diff(norm.cdf(Z_EDGES[edges]))).pvalue


TESTS = {"ranks": p_of_ranks, "distances": p_of_distances, "held-out": p_of_heldout}


@pytest.mark.parametrize("form", ["real", "complex"])
@pytest.mark.parametrize("statistic", TESTS)
def test_truth_is_a_draw_from_its_posterior(form, statistic):
    assert TESTS[statistic](calibrate(form)) > CHANCE


@pytest.mark.parametrize(
    ("form", "stated"),
    [
        ("real", 2.0),
        ("complex", 0.5),
        pytest.param("real", 0.5, marks=pytest.mark.study),
        pytest.param("complex", 2.0, marks=pytest.mark.study),
    ],
)
@pytest.mark.parametrize("statistic", TESTS)
def test_a_wrong_noise_variance_would_be_seen(form, statistic, stated):
    assert TESTS[statistic](calibrate(form, stated)) < HOPELESS
