"""What a result says of beam and effects is one Gaussian over all channels, also where these share parameters."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.learned import Learned
from hydrabeam_mpi.fit.state import Active, Estimate, Values, independent_prior
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import FactoredPrior

N, OWN, SHARED, CHANNELS = 5, 4, 3, 3
Q = OWN + SHARED


def random_covariance(rng: np.random.Generator, n: int) -> FloatArray:
    root = rng.standard_normal((n, n + 2))
    return root @ root.T / n


def whole(rng: np.random.Generator) -> FloatArray:
    """Return a precision of s and of x_f of all channels: given s, channels know nothing of each other."""
    precision = np.zeros((SHARED + CHANNELS * OWN,) * 2)
    for f in range(CHANNELS):
        index = np.r_[SHARED + f * OWN : SHARED + (f + 1) * OWN, :SHARED]
        precision[np.ix_(index, index)] += random_covariance(rng, Q) + 0.1 * np.eye(Q)
    return precision


def index_of(channel: int) -> IntArray:
    return np.r_[SHARED + channel * OWN : SHARED + (channel + 1) * OWN, :SHARED]


def effects(rng: np.random.Generator) -> Values:
    active = []
    for effect, n in ((AntennaGains(), OWN), (AntennaDelays(), SHARED)):
        used, prior = independent_prior(rng.uniform(0.5, 2.0, n), effect.shared)
        x = rng.standard_normal((1 if effect.shared else CHANNELS, n))
        x = np.broadcast_to(x, (CHANNELS, n)).copy()
        active.append(Active(effect, used, prior, x, np.full(n, np.inf), np.zeros((0, n))))
    return Values(tuple(active))


@pytest.fixture(name="learned")
def made() -> tuple[Learned, FloatArray]:
    rng = np.random.default_rng(3)
    precision = whole(rng)
    covariance = np.linalg.inv(precision)
    of_channels = tuple(covariance[np.ix_(index_of(f), index_of(f))] for f in range(CHANNELS))
    beams = {
        f: FactoredPrior(rng.standard_normal(N), np.linalg.cholesky(random_covariance(rng, N))) for f in range(CHANNELS)
    }
    response = {f: rng.standard_normal((N, Q)) for f in range(CHANNELS)}
    return Learned(effects(rng), of_channels, beams, response), precision


def moved(learned: Learned, seed: int) -> tuple[Values, FloatArray]:
    """Return other values of the parameters, and how far away they are, of all channels side by side, s first."""
    rng = np.random.default_rng(seed)
    away = np.concatenate([shared := rng.standard_normal(SHARED), *(own := rng.standard_normal((CHANNELS, OWN)))])
    step = np.concatenate([own, np.broadcast_to(shared, (CHANNELS, SHARED))], axis=1)
    return learned.values.at(learned.values.x + step), away


def log_prior(values: Values) -> float:
    return sum(one.prior.log_density(one.x) for one in values.active)


def test_its_likelihood_times_its_prior_is_its_posterior(learned: tuple[Learned, FloatArray]) -> None:
    known, precision = learned
    found = []
    for seed in range(3):
        values, away = moved(known, seed)
        found.append(known.log_likelihood(values) + log_prior(values) + 0.5 * away @ precision @ away)
    np.testing.assert_allclose(found, found[0], atol=1e-9)


def test_the_sums_have_its_gradient_and_curvature(learned: tuple[Learned, FloatArray]) -> None:
    """Of beam and effects in one channel, by differences of what beam's prior and likelihood of effects come to."""
    known, _ = learned
    values, _ = moved(known, 7)
    rng = np.random.default_rng(1)
    beams = tuple(Posterior(rng.standard_normal(N), np.eye(N)) for _ in range(CHANNELS))
    gradient, curvature = np.zeros((CHANNELS, Q)), []
    for f in range(CHANNELS):
        sums = NormalEquations([Block(BEAM, N), *(Block(name, one.size) for name, one in values.blocks.items())])
        known.add_to(sums, values.blocks, f, Estimate(values, beams))
        likelihood = sums.likelihood_alone(list(values.blocks))
        gradient[f] = likelihood.score
        curvature.append(likelihood.signal)

    def reached(step: FloatArray) -> float:
        at = values.at(values.x + step)
        total = known.log_likelihood(at)
        for f, beam in enumerate(beams):
            prior = known.beam_prior(f, at)
            total -= 0.5 * float((away := beam.mean - prior.mean) @ prior.precision_times(away))
        return total

    direction = rng.standard_normal((CHANNELS, Q))
    direction[:, OWN:] = direction[0, OWN:]
    up, here, down = (reached(one * direction) for one in (1.0, 0.0, -1.0))
    np.testing.assert_allclose((up - down) / 2, np.sum(gradient * direction), rtol=1e-9)
    second = sum(float(one @ matrix @ one) for one, matrix in zip(direction, curvature, strict=True))
    np.testing.assert_allclose(2 * here - up - down, second, rtol=1e-9)
