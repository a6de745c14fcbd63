"""The sums for effects against dense matrices, and the marginalised beam against the inverse of everything."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.base import Columns
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.infer.normal import NormalEquations
from hydrabeam_mpi.infer.posterior import Posterior, solve_posterior
from hydrabeam_mpi.infer.prior import DiagonalPrior
from hydrabeam_mpi.loop.equations import JointSums, SceneSums, beam_change
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_experiment, small_scene

N_MODES = 7
FORMS = ["real", "complex"]
# Active ones first: sparse and dense, by baseline and by group, one with parameters that occur twice in a row.
ACTIVE = ("by baseline, sparse", "by group")
CANDIDATES = ("by baseline", "by group, sparse", "twice in a row")
PARAMETERS = {"by baseline, sparse": 7, "by group": 3, "by baseline": 4, "by group, sparse": 4, "twice in a row": 5}


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return small_experiment(freqs=(131e6,), n_times=4, n_sources=20)


@dataclass(frozen=True)
class Case:
    """A scene with a residual, uneven weights (some zero), a design and columns of every kind."""

    scene: Scene
    design: np.ndarray
    columns: dict[str, Columns]

    def part(self, times: np.ndarray, bls: np.ndarray) -> Case:
        """Keep some times and baselines, as a rank has them."""
        scene = self.scene
        groups, member = np.unique(scene.member[bls], return_inverse=True)
        rows = np.ix_(times, bls)
        part = replace(
            scene,
            times=scene.times[times],
            bls=scene.bls[bls],
            groups=scene.groups[groups],
            member=member,
            weights=scene.weights[rows],
            residual=scene.residual[rows],
        )
        is_complex = np.iscomplexobj(self.design)
        design = self.design[times][:, groups] if is_complex else self.design[times][:, :, groups]
        columns = {}
        for name, one in self.columns.items():
            own = np.ix_(times, groups if one.by_group else bls)
            index = None if one.index is None else np.broadcast_to(one.index, one.values.shape)[own]
            columns[name] = replace(one, values=one.values[own], index=index)
        return Case(part, design, columns)

    def dense(self, name: str) -> ComplexArray:
        """Write out columns for every row, (Ntimes x Nbls, q)."""
        one = self.columns[name]
        n_times, n_rows, k = one.values.shape
        index = np.broadcast_to(np.arange(k) if one.index is None else one.index, one.values.shape)
        rows = np.zeros((n_times, n_rows, one.n_params), dtype=complex)
        for t, row, j in np.ndindex(one.values.shape):
            rows[t, row, index[t, row, j]] += one.values[t, row, j]
        if one.by_group:
            rows = rows[:, self.scene.member]
        return rows.reshape(-1, one.n_params)

    @property
    def dense_design(self) -> ComplexArray:
        """Design rows of every baseline, (Ntimes x Nbls, n)."""
        rows = self.design if np.iscomplexobj(self.design) else self.design[:, 0] + 1j * self.design[:, 1]
        return rows[:, self.scene.member].reshape(-1, N_MODES)

    @property
    def weights(self) -> FloatArray:
        return self.scene.weights.reshape(-1)


@pytest.fixture(scope="module", params=FORMS)
def case(request: pytest.FixtureRequest, experiment: Experiment) -> Case:
    scene = small_scene(experiment)
    n_times, n_bls = scene.shape
    n_groups = len(scene.groups)
    rng = generator(3, "sums")
    scene.weights = rng.uniform(0.5, 2, scene.shape)
    scene.weights[1, 3], scene.weights[:, 7], scene.weights[2] = 0.0, 0.0, 0.0
    scene.residual = complex_normal(rng, scene.shape)
    scene.residual[2] = 1e6  # flagged
    if request.param == "complex":
        design = complex_normal(rng, (n_times, n_groups, N_MODES))
    else:
        design = rng.standard_normal((n_times, 2, n_groups, N_MODES))
    antennas = np.stack([scene.ant1, scene.ant2], axis=1)
    columns = {
        "by baseline, sparse": Columns(complex_normal(rng, (n_times, n_bls, 2)), 7, antennas),
        "by group": Columns(complex_normal(rng, (n_times, n_groups, 3)), 3, by_group=True),
        "by baseline": Columns(complex_normal(rng, (n_times, n_bls, 4)), 4),
        "by group, sparse": Columns(
            complex_normal(rng, (n_times, n_groups, 2)),
            4,
            np.arange(2 * n_times).reshape(n_times, 1, 2) % 4,
            by_group=True,
        ),
        "twice in a row": Columns(complex_normal(rng, (n_times, n_bls, 3)), 5, rng.integers(5, size=(n_bls, 3))),
    }
    return Case(scene, design, columns)


def add_up(cases: list[Case]) -> JointSums:
    """Sum over scenes."""
    is_complex = np.iscomplexobj(cases[0].design)
    sizes = [PARAMETERS[name] for name in CANDIDATES]
    total = JointSums.zeros(sum(PARAMETERS[name] for name in ACTIVE), sizes, N_MODES, is_complex)
    for one in cases:
        sums = SceneSums(one.scene, one.design)
        active = [sums.part(one.columns[name]) for name in ACTIVE]
        total.add(sums, active, None, None)
        for i, name in enumerate(CANDIDATES):
            total.add(sums, active, i, sums.part(one.columns[name]))
    return total


def posterior_of(case: Case) -> Posterior:
    """The beam's, with a prior of a standard deviation for each coefficient."""
    is_complex = np.iscomplexobj(case.design)
    normal = NormalEquations.zeros(N_MODES, is_complex)
    rows = case.dense_design
    if not is_complex:
        rows = np.stack([rows.real, rows.imag])
    data = case.scene.residual.reshape(-1)
    normal.add_data(data, case.weights)
    normal.add_rows(rows, case.weights * data, case.weights)
    normal.symmetrise()
    return solve_posterior(normal, DiagonalPrior(np.zeros(N_MODES), prior_std()))


def prior_std() -> FloatArray:
    return np.linspace(0.05, 0.5, N_MODES)


def fisher(case: Case, columns: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return the information on the beam's real parameters and those of the columns, and the gradient at zero."""
    design, std = case.dense_design, prior_std()
    if np.iscomplexobj(case.design):
        # Real and imaginary parts of the coefficients, each with half of their variance.
        design, std = np.concatenate([design, 1j * design], axis=1), np.tile(std, 2) / np.sqrt(2)
    everything = np.concatenate([design, columns], axis=1)
    weighted = case.weights[:, np.newaxis] * everything
    information = 2 * (everything.conj().T @ weighted).real
    information[: len(std), : len(std)] += np.diag(std**-2.0)
    return information, 2 * (weighted.conj().T @ case.scene.residual.reshape(-1)).real


def test_sums_are_those_of_dense_matrices(case: Case) -> None:
    total = add_up([case])
    active = np.concatenate([case.dense(name) for name in ACTIVE], axis=1)
    weights, residual, design = case.weights[:, np.newaxis], case.scene.residual.reshape(-1), case.dense_design
    factor = np.sqrt(2) if np.iscomplexobj(case.design) else 2.0
    for sums, columns in [
        (total.active, active),
        *((total.candidates[i], case.dense(name)) for i, name in enumerate(CANDIDATES)),
    ]:
        np.testing.assert_allclose(sums.signal, 2 * (columns.conj().T @ (weights * columns)).real, atol=1e-10)
        np.testing.assert_allclose(sums.score, 2 * ((weights * columns).conj().T @ residual).real, atol=1e-10)
        cross = factor * (design.conj().T @ (weights * columns))
        np.testing.assert_allclose(sums.cross, cross if np.iscomplexobj(case.design) else cross.real, atol=1e-10)
    for across, name in zip(total.across, CANDIDATES, strict=True):
        np.testing.assert_allclose(across, 2 * (active.conj().T @ (weights * case.dense(name))).real, atol=1e-10)


def test_only_some_parameters_count(case: Case) -> None:
    sums = SceneSums(case.scene, case.design)
    used = np.array([4, 0])
    total = JointSums.zeros(2, [], N_MODES, sums.is_complex)
    total.add(sums, [sums.part(case.columns["by baseline, sparse"], used)], None, None)
    columns = case.dense("by baseline, sparse")[:, used]
    weighted = case.weights[:, np.newaxis] * columns
    np.testing.assert_allclose(total.active.signal, 2 * (columns.conj().T @ weighted).real, atol=1e-10)
    np.testing.assert_allclose(
        total.active.score, 2 * (weighted.conj().T @ case.scene.residual.reshape(-1)).real, atol=1e-10
    )


@pytest.mark.parametrize("name", CANDIDATES)
def test_beam_is_marginalised(case: Case, name: str) -> None:
    """The inverse of the information on everything holds the covariance of the effects with the beam free."""
    likelihood = add_up([case]).candidate(CANDIDATES.index(name), posterior_of(case))
    columns = np.concatenate([case.dense(one) for one in (*ACTIVE, name)], axis=1)
    information, score = fisher(case, columns)
    n_beam = len(information) - columns.shape[1]
    covariance = np.linalg.inv(information)[n_beam:, n_beam:]
    np.testing.assert_allclose(likelihood.information @ covariance, np.eye(columns.shape[1]), atol=1e-7)
    np.testing.assert_allclose(likelihood.signal, information[n_beam:, n_beam:], atol=1e-9)
    np.testing.assert_allclose(likelihood.score, score[n_beam:], atol=1e-9)


def test_beam_follows(case: Case) -> None:
    """By how much the best beam moves with an effect: from the cross terms of the information on everything."""
    total, posterior = add_up([case]), posterior_of(case)
    columns = np.concatenate([case.dense(name) for name in ACTIVE], axis=1)
    information, _ = fisher(case, columns)
    n_beam = len(information) - columns.shape[1]
    follows = -np.linalg.solve(information[:n_beam, :n_beam], information[:n_beam, n_beam:])
    if posterior.is_complex:
        follows = follows[:N_MODES] + 1j * follows[N_MODES:]
    np.testing.assert_allclose(beam_change(posterior, total.active.cross), follows, atol=1e-10)


def test_score_at_the_best_beam_is_that_with_the_beam_free(case: Case) -> None:
    """The residual of the posterior mean needs no further marginalisation."""
    posterior = posterior_of(case)
    name = "by baseline"
    information, score = fisher(case, case.dense(name))
    n_beam = len(information) - PARAMETERS[name]
    taken = information[n_beam:, :n_beam] @ np.linalg.solve(information[:n_beam, :n_beam], score[:n_beam])
    fitted = (case.dense_design @ posterior.mean).reshape(case.scene.shape)
    at_best = replace(case, scene=replace(case.scene, residual=case.scene.residual - fitted))
    found = add_up([at_best]).candidates[CANDIDATES.index(name)].score
    np.testing.assert_allclose(found, score[n_beam:] - taken, atol=1e-9)


@pytest.mark.parametrize("how", ["times", "baselines", "both, and nothing"])
def test_sums_add_up_over_scenes(case: Case, how: str) -> None:
    n_times, n_bls = case.scene.shape
    times, bls = np.arange(n_times), np.arange(n_bls)
    # Redundant baselines may be on different ranks.
    halves = {"times": [(times[:1], bls), (times[1:], bls)], "baselines": [(times, bls[::2]), (times, bls[1::2])]}
    tiles = halves.get(how, [(times[:2], bls), (times[2:], bls[:5]), (times[2:], bls[5:]), (times[:0], bls[:0])])
    whole, parts = add_up([case]), add_up([case.part(*tile) for tile in tiles])
    for one, two in zip([whole.active, *whole.candidates], [parts.active, *parts.candidates], strict=True):
        np.testing.assert_allclose(two.signal, one.signal, atol=1e-10)
        np.testing.assert_allclose(two.score, one.score, atol=1e-10)
        np.testing.assert_allclose(two.cross, one.cross, atol=1e-10)
    for one, two in zip(whole.across, parts.across, strict=True):
        np.testing.assert_allclose(two, one, atol=1e-10)


@pytest.mark.mpi
def test_sums_add_up_over_ranks(case: Case, comm: MPI.Comm) -> None:
    times, bls = np.array_split(np.arange(case.scene.shape[0]), comm.size)[comm.rank], np.arange(case.scene.shape[1])
    mine = add_up([case.part(times, bls)])
    mine.reduce(comm)
    whole = add_up([case])
    for one, two in zip([whole.active, *whole.candidates], [mine.active, *mine.candidates], strict=True):
        np.testing.assert_allclose(two.signal, one.signal, atol=1e-10)
        np.testing.assert_allclose(two.cross, one.cross, atol=1e-10)
    for one, two in zip(whole.across, mine.across, strict=True):
        np.testing.assert_allclose(two, one, atol=1e-10)


def test_flagged_rows_do_not_count(case: Case) -> None:
    spoilt = case.scene.residual.copy()
    spoilt[case.scene.weights == 0] = -1e9
    one = add_up([case])
    two = add_up([replace(case, scene=replace(case.scene, residual=spoilt))])
    np.testing.assert_array_equal(one.active.score, two.active.score)
    everything = replace(case, scene=replace(case.scene, weights=np.zeros(case.scene.shape)))
    nothing = add_up([everything])
    for sums in (nothing.active, *nothing.candidates):
        assert not np.any(sums.signal)
        assert not np.any(sums.score)
        assert not np.any(sums.cross)


def test_no_effects_are_no_trouble(case: Case) -> None:
    sums = SceneSums(case.scene, case.design)
    total = JointSums.zeros(0, [0], N_MODES, sums.is_complex)
    total.add(sums, [], None, None)
    total.add(sums, [], 0, sums.part(Columns(np.zeros((*case.scene.shape, 0), dtype=complex), 0)))
    likelihood = total.candidate(0, posterior_of(case))
    assert likelihood.information.shape == (0, 0)
