"""The joint fit of beams and effects: what was injected comes back, and the answer is that of dense least squares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import least_squares

from hydrabeam_mpi.accumulate import designs
from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.diagnose import evaluate_on_grid
from hydrabeam_mpi.effects.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.base import Effect
from hydrabeam_mpi.effects.catalogue import make_effect
from hydrabeam_mpi.effects.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.missing_sources import MissingSources
from hydrabeam_mpi.effects.noise_level import NoiseLevel
from hydrabeam_mpi.effects.nonredundant_beams import NonredundantBeams
from hydrabeam_mpi.inference import Clock, infer_channels
from hydrabeam_mpi.loop.heldout import blocks_of, whiten
from hydrabeam_mpi.loop.joint import channel_results
from hydrabeam_mpi.loop.refit import Space, refit
from hydrabeam_mpi.loop.state import Active, Reweighted, State
from tests.loop.mock import FREQ, mock_job, space_of, truth_of

TWO = (FREQ, FREQ + 8e6)


def free(space: Space, effect: Effect, width: float, only: Sequence[int] | None = None) -> Active:
    """Start at zero with a prior of ``width`` natural sizes for all parameters with a derivative, or only for some."""
    parameters = effect.parameters(space.experiment)
    chosen = np.isin(np.arange(len(parameters)), np.arange(len(parameters)) if only is None else only)
    prior_var = np.where(chosen & ~parameters.refined, (width * parameters.scale) ** 2, 0.0)
    return Active.start(effect, space.experiment, prior_var, np.zeros(len(parameters)))


def heldout_chi2(space: Space, state: State) -> float:
    return blocks_of(space, whiten(space, state)).chi2


def beam_error(space: Space, state: State, folder: Path) -> float:
    """Return the root mean square difference from the true beam of the first channel."""
    with h5py.File(folder / "truth.h5") as file:
        truth = file["beam"][0]
    found = evaluate_on_grid(lambda za, az: space.problem.basis.synthesize(state.posteriors[0].mean, za, az))
    return float(np.sqrt(np.mean((found - truth) ** 2)))


# What is injected, by name; the effect that is fitted; and the prior's width in natural sizes.
GAINS = {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05, "antenna 5 phase": 0.04}
POSITIONS = {"antenna 1 displaced East": 0.08, "antenna 6 displaced North": -0.05, "antenna 3 displaced Up": 0.1}
COUPLING = {"baseline 1-4 real": 0.8, "baseline 1-4 imaginary": -0.5, "baseline 0-6 imaginary": 0.6}
CASES: dict[str, tuple[dict[str, Any], Effect, float]] = {
    "antenna_gains": ({"kind": "antenna_gains", "parameters": GAINS}, AntennaGains(), 0.1),
    "antenna_positions": ({"kind": "antenna_positions", "parameters": POSITIONS}, AntennaPositions(), 1.0),
    "cross_coupling": (
        {"kind": "cross_coupling", "settings": {"baselines": [[1, 4], [0, 6]]}, "parameters": COUPLING},
        CrossCoupling([[1, 4], [0, 6]]),
        1.0,
    ),
}


@pytest.mark.parametrize("freqs", [(FREQ,), TWO], ids=["one channel", "two channels"])
@pytest.mark.parametrize("kind", CASES)
def test_what_was_injected_comes_back(kind: str, freqs: tuple[float, ...], tmp_path: Path) -> None:
    injected, effect, width = CASES[kind]
    space = space_of(mock_job(injected, freqs=freqs), tmp_path)
    without = refit(space, State())
    state = refit(space, without.extended(free(space, effect, width)))
    (truth,) = truth_of(tmp_path)
    names = effect.parameters(space.experiment).names
    assert truth["kind"] == kind
    assert truth["names"] == list(names)
    (active,) = state.active
    error, std = active.x - np.array(truth["values"]), active.std
    # What the data cannot tell is in the beam, or nowhere.
    held = effect.undecidable(space.experiment)
    error -= (error @ held.T) @ held
    assert error.shape == std.shape == (len(freqs), len(names))
    assert np.all(np.abs(error) < 4 * std)
    strong = np.abs(truth["values"]) > 0
    assert np.all(np.abs(np.array(truth["values"]))[strong] > 5 * std[strong]), "should be detectable"
    assert heldout_chi2(space, without) > 1.5
    assert heldout_chi2(space, state) < 1.4
    assert beam_error(space, state, tmp_path) < beam_error(space, without, tmp_path)


@pytest.mark.parametrize("freqs", [(FREQ,), TWO], ids=["one channel", "two channels"])
def test_a_missing_source_is_found_where_it_is(freqs: tuple[float, ...], tmp_path: Path) -> None:
    """It is sought 0.8 degrees away, a third of the distance of candidates."""
    ra, dec, flux, bend = 130.0, -25.0, 2.0, 0.4
    values = {f"source at ra={ra:.3f} dec={dec:.3f}: flux": flux}
    if len(freqs) > 1:
        values[f"source at ra={ra:.3f} dec={dec:.3f}: change of spectral index"] = bend
    injected = {"kind": "missing_sources", "settings": {"sources": [[ra, dec]]}, "parameters": values}
    space = space_of(mock_job(injected, freqs=freqs), tmp_path)
    ra0, dec0 = ra + 0.7, dec - 0.5
    without = refit(space, State())
    effect = MissingSources([(ra0, dec0)])
    start = free(space, effect, 1.0)
    start.x[:, 0] = 0.5
    state = refit(space, without.extended(start))
    (active,) = state.active
    # Gnomonic projection about the place where it was sought.
    a, d, d0 = np.deg2rad([ra - ra0, dec, dec0])
    cosine = np.sin(d0) * np.sin(d) + np.cos(d0) * np.cos(d) * np.cos(a)
    east = np.rad2deg(np.cos(d) * np.sin(a) / cosine)
    north = np.rad2deg((np.cos(d0) * np.sin(d) - np.sin(d0) * np.cos(d) * np.cos(a)) / cosine)
    truth = np.array([flux, east, north, bend][: active.x.shape[1]])
    assert np.all(active.x == active.x[0])
    error = active.x[0] - truth
    assert np.all(np.abs(error) < 4 * active.std[0])
    assert active.std[0, 0] < flux / 10
    assert np.all(active.std[0, 1:3] < 0.2)
    assert heldout_chi2(space, without) > 1.5
    assert heldout_chi2(space, state) < 1.4


@dataclass
class Dense:
    """Least squares of all beams and parameters at once, on the data as they were read.

    ``model(f, x)`` gives C and E of channel f at the parameters in use of that channel.
    """

    space: Space
    state: State
    model: Callable[[int, FloatArray], tuple[Any, Any]]

    def __post_init__(self) -> None:
        rows, problem = self.space.train.rows, self.space.problem
        model = problem.forward_model(rows.groups)
        by_time = np.array(list(designs(rows, model, problem.basis, "", show=False)))  # (Ntimes, Nfreqs, 2, Ngroups, n)
        self.design = np.moveaxis(by_time[:, :, 0] + 1j * by_time[:, :, 1], 1, 0)[:, :, rows.member]
        self.data, self.root = rows.data, np.sqrt(2 * rows.inv_noise_var)
        self.shared = np.concatenate([[one.effect.shared] * len(one.used) for one in self.state.active]).astype(bool)
        self.n_freqs, self.n_modes = len(self.data), self.design.shape[-1]

    def split(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return beams (Nfreqs, n) and parameters (Nfreqs, q) from all unknowns, in units of their priors."""
        beams, rest = np.split(p, [self.n_freqs * self.n_modes])
        common, own = np.split(rest, [int(self.shared.sum())])
        x = np.empty((self.n_freqs, len(self.shared)))
        x[:, self.shared], x[:, ~self.shared] = common, own.reshape(self.n_freqs, -1)
        mean = np.array([prior.mean for prior in self.space.problem.priors])
        std = np.array([prior.std() for prior in self.space.problem.priors])
        return mean + std * beams.reshape(self.n_freqs, -1), np.sqrt(self.state.prior_var) * x

    def residuals(self, p: FloatArray) -> FloatArray:
        """Return whitened residuals, those of the priors, and what is held at zero."""
        beams, x = self.split(p)
        parts = []
        for f in range(self.n_freqs):
            factor, added = self.model(f, x[f])
            left = self.root[f] * (self.data[f] - factor * (self.design[f] @ beams[f] + added))
            parts += [left.real.ravel(), left.imag.ravel()]
        start = 0
        for one in self.state.active:
            span = slice(start, start + len(one.used))
            parts.append(1e5 * (x[:, span] / np.sqrt(one.prior_var[one.used]) @ one.undecidable[:, one.used].T).ravel())
            start = span.stop
        return np.concatenate([*parts, p])

    def solve(self) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
        """Return beams, parameters, and the covariance of each channel's beam and parameters."""
        n_own = int(np.sum(~self.shared))
        n = self.n_freqs * (self.n_modes + n_own) + int(self.shared.sum())
        found = least_squares(self.residuals, np.zeros(n), method="lm", xtol=1e-14, ftol=1e-14)
        covariance = np.linalg.inv(found.jac.T @ found.jac)
        # The unknowns are linear in what they are made of.
        origin = np.concatenate([np.ravel(part) for part in self.split(np.zeros(n))])
        made = [np.concatenate([np.ravel(part) for part in self.split(unit)]) - origin for unit in np.eye(n)]
        to_all = np.array(made).T
        everything = to_all @ covariance @ to_all.T
        beams, x = self.split(found.x)
        q, edge = len(self.shared), self.n_freqs * self.n_modes
        channels = []
        for f in range(self.n_freqs):
            own = np.r_[f * self.n_modes : (f + 1) * self.n_modes, edge + f * q : edge + (f + 1) * q]
            channels.append(everything[np.ix_(own, own)])
        return beams, x, channels


def gain_factor(space: Space, amplitude: FloatArray, phase: FloatArray) -> Any:
    """Return g_j g_k* of each row."""
    one, two = antennas(space).T
    return np.exp(amplitude[one] + amplitude[two] + 1j * (phase[one] - phase[two]))


def antennas(space: Space) -> IntArray:
    """Return the antennas of each row in the sense of its group, (Nbls, 2)."""
    return space.experiment.antenna_index[space.train.rows.tile.bls]


def all_gains(space: Space) -> tuple[list[Active], Callable[[int, FloatArray], tuple[Any, Any]]]:
    return [free(space, AntennaGains(), 0.1)], lambda f, x: (gain_factor(space, x[::2], x[1::2]), 0.0)


def couplings(space: Space) -> tuple[list[Active], Callable[[int, FloatArray], tuple[Any, Any]]]:
    pairs = [[1, 4], [0, 6]]
    rows = [_row(space, *pair) for pair in pairs]

    def model(f: int, x: FloatArray) -> tuple[Any, Any]:
        added = np.zeros(space.train.rows.data.shape[2], dtype=complex)
        added[rows] = x[::2] + 1j * x[1::2]
        return 1.0, added

    return [free(space, CrossCoupling(pairs), 1.0)], model


def several(space: Space) -> tuple[list[Active], Callable[[int, FloatArray], tuple[Any, Any]]]:
    """Gains of each channel, delays that channels share, and a coupling."""
    active = [
        free(space, AntennaGains(), 0.1, [0, 2, 9]),
        free(space, AntennaDelays(), 1.0, [2, 3]),
        free(space, CrossCoupling([[2, 6]]), 1.0),
    ]
    names = active[1].effect.parameters(space.experiment).names
    assert all(f"antenna {i}" in names[i] for i in (2, 3))
    row = _row(space, 2, 6)

    def model(f: int, x: FloatArray) -> tuple[Any, Any]:
        amplitude, phase, added = np.zeros(7), np.zeros(7), np.zeros(21, dtype=complex)
        amplitude[:2], phase[4], added[row] = x[:2], x[2], x[5] + 1j * x[6]
        turns = space.experiment.observation.freqs[f] * x[3:5] * 1e-9
        phase[[2, 3]] = 2 * np.pi * turns
        return gain_factor(space, amplitude, phase), added

    return active, model


def _row(space: Space, one: int, two: int) -> int:
    (row,) = np.flatnonzero(np.all(np.sort(antennas(space), axis=1) == [one, two], axis=1))
    return int(row)


SEVERAL = [
    {"kind": "antenna_gains", "parameters": {"antenna 0 ln amplitude": 0.1, "antenna 4 phase": -0.1}},
    {"kind": "antenna_delays", "parameters": {"antenna 2 delay": 0.2, "antenna 3 delay": -0.1}},
    {"kind": "cross_coupling", "settings": {"baselines": [[2, 6]]}, "parameters": {"baseline 2-6 real": 0.4}},
]


@pytest.mark.parametrize(
    ("make", "injected", "freqs"),
    [
        (all_gains, [CASES["antenna_gains"][0]], (FREQ,)),
        (couplings, [CASES["cross_coupling"][0]], (FREQ,)),
        (several, SEVERAL, TWO),
    ],
    ids=["nonlinear, something held", "linear", "several effects and channels"],
)
def test_the_fit_is_dense_least_squares(
    make: Any, injected: list[dict[str, Any]], freqs: tuple[float, ...], tmp_path: Path
) -> None:
    """Means and covariances of beams and effects, in whatever blocks they are solved for."""
    space = space_of(mock_job(*injected, freqs=freqs), tmp_path)
    active, model = make(space)
    state = refit(space, State(active=active))
    beams, x, covariances = Dense(space, state, model).solve()
    found = np.concatenate([one.x[:, one.used] for one in state.active], axis=1)
    std = np.concatenate([one.std[:, one.used] for one in state.active], axis=1)
    n = beams.shape[1]
    results = channel_results(space, state)
    for f, covariance in enumerate(covariances):
        expected = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(found[f], x[f], atol=0.01 * expected[n:].min(), rtol=0)
        np.testing.assert_allclose(std[f], expected[n:], rtol=2e-3)
        scaled = np.outer(expected[n:], expected[n:])
        np.testing.assert_allclose(state.covariances[f] / scaled, covariance[n:, n:] / scaled, atol=2e-3)
        posterior = state.posteriors[f]
        assert np.all(np.abs(posterior.mean - beams[f]) < 0.01 * expected[:n])
        # Given the effects the beam is known better than with them free, which is what `infer` tells.
        assert np.all(posterior.std < expected[:n] * (1 + 1e-6))
        scaled = np.outer(expected[:n], expected[:n])
        np.testing.assert_allclose(results[f].posterior.covariance / scaled, covariance[:n, :n] / scaled, atol=2e-3)


def test_without_effects_it_is_plain_inference(tmp_path: Path) -> None:
    space = space_of(mock_job(freqs=TWO), tmp_path)
    state = refit(space, State())
    plain = infer_channels(space.grid, space.problem, Clock())
    for f, (posterior, one, result) in enumerate(
        zip(state.posteriors, plain, channel_results(space, state), strict=True)
    ):
        np.testing.assert_array_equal(posterior.mean, one.posterior.mean)
        np.testing.assert_array_equal(posterior.factor, one.posterior.factor)
        assert result.heldout.summary() == one.heldout.summary()
        assert state.train_chi2[f] > 0.7


def test_it_comes_back_from_afar(tmp_path: Path) -> None:
    """A phase of more than a radian, from zero: no single step is linear."""
    injected = {"kind": "antenna_gains", "parameters": {"antenna 2 phase": 1.3, "antenna 5 ln amplitude": -0.5}}
    space = space_of(mock_job(injected), tmp_path)
    state = refit(space, State(active=[free(space, AntennaGains(), 1.0, [4, 5, 10, 11])]))
    (active,) = state.active
    truth = np.array(truth_of(tmp_path)[0]["values"])
    used = active.used
    assert used.tolist() == [4, 5, 10, 11]
    assert np.all(np.abs(active.x - truth)[:, used] < 4 * active.std[:, used])
    assert heldout_chi2(space, state) < 1.4


def fitted_chi2(space: Space, state: State) -> float:
    """Return chi^2 of the fitted rows of the first channel, with E as the state's own beam sees it."""
    rows, added = space.train.calibrated(state)
    scenes = [scene for _, scene, _ in space.train.scenes(0, state, added[0], rows)]
    return float(sum(np.sum(scene.weights * np.abs(scene.residual) ** 2) for scene in scenes))


@pytest.mark.parametrize("effect", [NonredundantBeams(), AntennaPositions()], ids=lambda effect: effect.kind)
def test_what_cannot_explain_the_data_makes_them_no_worse(effect: Effect, tmp_path: Path) -> None:
    """Gains that are badly wrong, and a beam that gives way: what is added changes as much as the beam does."""
    amplitudes = {f"antenna {i} ln amplitude": 0.5 * (-1) ** i for i in range(7)}
    injected = {"kind": "antenna_gains", "parameters": amplitudes | {"antenna 3 phase": 1.0}}
    space = space_of(mock_job(injected, prior={"kind": "fraction", "fraction": 1.0}), tmp_path)
    without = refit(space, State())
    state = refit(space, without.extended(free(space, effect, 10.0)))
    assert fitted_chi2(space, state) < fitted_chi2(space, without)


def test_a_fit_leaves_the_state_before_as_it_was(tmp_path: Path) -> None:
    space = space_of(mock_job(CASES["antenna_gains"][0]), tmp_path)
    before = refit(space, State(active=[free(space, AntennaGains(), 0.1)]))
    x, mean = before.active[0].x.copy(), before.posteriors[0].mean.copy()
    refit(space, before.extended(free(space, CrossCoupling([[0, 1]]), 1.0)))
    np.testing.assert_array_equal(before.active[0].x, x)
    np.testing.assert_array_equal(before.posteriors[0].mean, mean)
    assert len(before.active) == 1


def test_weights_that_are_wrong_scale_the_errors(tmp_path: Path) -> None:
    """Noise twice as large as told."""
    space = space_of(mock_job(), tmp_path)
    plain = refit(space, State(active=[free(space, CrossCoupling([[0, 1]]), 1.0)]))
    scale = np.array([[2.0]])
    double = Reweighted(NoiseLevel(), scale, np.zeros_like(scale))
    scaled = refit(space, State([free(space, CrossCoupling([[0, 1]]), 1.0)], [double]))
    assert scaled.train_chi2[0] == pytest.approx(plain.train_chi2[0] / 4, rel=0.05)
    np.testing.assert_allclose(scaled.active[0].std, 2 * plain.active[0].std, rtol=0.05)
    data = [result.normal.n_data for result in channel_results(space, scaled)]
    assert data == [8 * 21]


@pytest.mark.mpi
def test_any_number_of_ranks_fits_the_same(comm: MPI.Comm, common_tmp_path: Path) -> None:
    """Two channels with effects that they share and that they do not."""
    injected = [CASES["antenna_gains"][0], CASES["antenna_positions"][0]]
    states = []
    for name, world in (("all", comm), ("one", MPI.COMM_SELF)):
        folder = common_tmp_path / (name if world is comm else f"{name}{comm.rank}")
        space = space_of(mock_job(*injected, freqs=TWO, n_times=9), folder, world)
        active = [free(space, AntennaGains(), 0.1), free(space, AntennaPositions(), 1.0)]
        states.append((space, refit(space, State(active=active))))
    (space, many), (_, one) = states
    for mine, other in zip(many.active, one.active, strict=True):
        used = other.used
        assert np.all(np.abs(mine.x - other.x)[:, used] < 1e-6 * other.std[:, used])
        np.testing.assert_allclose(mine.std, other.std, rtol=1e-6)
    for channel, number in enumerate(space.channels):
        posterior, expected = many.posteriors[channel], one.posteriors[number]
        assert np.all(np.abs(posterior.mean - expected.mean) < 1e-6 * expected.std)


def test_an_effect_comes_back_from_its_description() -> None:
    effect = make_effect("missing_sources", MissingSources([(10.0, -30.0)], trials=50).describe())
    assert isinstance(effect, MissingSources)
    assert effect.sources == ((10.0, -30.0),)
