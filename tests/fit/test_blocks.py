"""The sums for effects against dense matrices, and the marginalised beam against the inverse of everything."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.registry import EFFECTS
from hydrabeam_mpi.fit.blocks import (
    BeamBlock,
    CandidateBlock,
    ModelBlock,
    add_block,
    beam_columns,
    effect_columns,
    row_set,
    sums_of,
)
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.row_buffer import RowBuffer
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import ChannelPrior, DiagonalPrior, FlatPrior
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.cases import draw, set_up
from tests.effects.small import small_block, small_setup

N_MODES = 7
FORMS = ["real", "complex"]
# Active ones first: sparse and dense, by baseline and by group, one with parameters that occur twice in a row.
ACTIVE = ("by baseline, sparse", "by group")
CANDIDATES = ("by baseline", "by group, sparse", "twice in a row")
PARAMETERS = {"by baseline, sparse": 7, "by group": 3, "by baseline": 4, "by group, sparse": 4, "twice in a row": 5}


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return small_setup(freqs=(131e6,), n_times=4, n_sources=20)


@dataclass(frozen=True)
class Case:
    """A scene with a residual, uneven weights (some zero), a design and columns of every kind."""

    block: RowBlock
    design: np.ndarray
    columns: dict[str, Columns]

    def part(self, times: np.ndarray, bls: np.ndarray) -> Case:
        """Keep some times and baselines, as a rank has them."""
        block = self.block
        groups, member = np.unique(block.member[bls], return_inverse=True)
        rows = np.ix_(times, bls)
        part = replace(
            block,
            times=block.times[times],
            bls=block.bls[bls],
            groups=block.groups[groups],
            member=member,
            weights=block.weights[rows],
            residual=block.residual[rows],
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
            rows = rows[:, self.block.member]
        return rows.reshape(-1, one.n_params)

    @property
    def dense_design(self) -> ComplexArray:
        """Design rows of every baseline, (Ntimes x Nbls, n)."""
        rows = self.design if np.iscomplexobj(self.design) else self.design[:, 0] + 1j * self.design[:, 1]
        return rows[:, self.block.member].reshape(-1, N_MODES)

    @property
    def weights(self) -> FloatArray:
        return self.block.weights.reshape(-1)


@pytest.fixture(scope="module", params=FORMS)
def case(request: pytest.FixtureRequest, setup: ObservingSetup) -> Case:
    block = small_block(setup)
    n_times, n_bls = block.shape
    n_groups = len(block.groups)
    rng = generator(3, "sums")
    block = replace(block, weights=rng.uniform(0.5, 2, block.shape))
    block.weights[1, 3], block.weights[:, 7], block.weights[2] = 0.0, 0.0, 0.0
    block = replace(block, residual=complex_normal(rng, block.shape))
    block.residual[2] = 1e6  # flagged
    if request.param == "complex":
        design = complex_normal(rng, (n_times, n_groups, N_MODES))
    else:
        design = rng.standard_normal((n_times, 2, n_groups, N_MODES))
    antennas = np.stack([block.ant1, block.ant2], axis=1)
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
    return Case(block, design, columns)


def add_up(cases: list[Case]) -> NormalEquations:
    """Sum over scenes: of the active effects, and of candidates one by one."""
    blocks = [Block(name, PARAMETERS[name]) for name in (*ACTIVE, *CANDIDATES)]
    pairs = [(one, two) for i, one in enumerate(ACTIVE) for two in ACTIVE[i:]]
    pairs += [(one, two) for two in CANDIDATES for one in (*ACTIVE, two)]
    pairs += [(BEAM, one.name) for one in blocks]
    total = NormalEquations([Block(BEAM, N_MODES, np.iscomplexobj(cases[0].design)), *blocks], pairs)
    for one in cases:
        rows = row_set(one.block)
        beam = {BEAM: beam_columns(rows, one.design)}
        active = {name: effect_columns(rows, one.columns[name]) for name in ACTIVE}
        total.add_rows(active, beam)
        for name in CANDIDATES:
            total.add_rows({name: effect_columns(rows, one.columns[name])}, beam | active)
    return total


def posterior_of(case: Case) -> Posterior:
    """The beam's, with a prior of a standard deviation for each coefficient."""
    is_complex = np.iscomplexobj(case.design)
    normal = NormalEquations([Block(BEAM, N_MODES, is_complex)])
    rows = case.dense_design
    if not is_complex:
        rows = np.stack([rows.real, rows.imag])
    data = case.block.residual.reshape(-1)
    normal.add_data(data, case.weights)
    buffer = RowBuffer(normal, BEAM)
    buffer.add(rows, case.weights * data, case.weights)
    buffer.flush()
    return normal.gaussian({BEAM: DiagonalPrior(np.zeros(N_MODES), prior_std())}).solve()


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
    return information, 2 * (weighted.conj().T @ case.block.residual.reshape(-1)).real


def product(total: NormalEquations, one: str, two: str) -> np.ndarray:
    """The product of two blocks' columns, both triangles of it."""
    return total.own(one) if one == two else total.gram[one, two]


def test_sums_are_those_of_dense_matrices(case: Case) -> None:
    total = add_up([case])
    weights, residual = case.weights[:, np.newaxis], case.block.residual.reshape(-1)
    dense = {BEAM: case.dense_design, **{name: case.dense(name) for name in (*ACTIVE, *CANDIDATES)}}
    for one, two in total.gram:
        found = product(total, one, two)
        expected = dense[one].conj().T @ (weights * dense[two])
        np.testing.assert_allclose(found, expected if np.iscomplexobj(found) else expected.real, atol=1e-10)
    for name in (*ACTIVE, *CANDIDATES):
        expected = ((weights * dense[name]).conj().T @ residual).real
        np.testing.assert_allclose(total.projection[name], expected, atol=1e-10)


def test_only_some_parameters_count(case: Case) -> None:
    used, name = np.array([4, 0]), "by baseline, sparse"
    total = NormalEquations([Block(name, 2)])
    rows = row_set(case.block)
    total.add_rows({name: effect_columns(rows, case.columns[name], used)})
    whole = add_up([case])
    np.testing.assert_allclose(total.own(name), whole.own(name)[np.ix_(used, used)], atol=1e-10)
    np.testing.assert_allclose(total.projection[name], whole.projection[name][used], atol=1e-10)


@pytest.mark.parametrize("name", CANDIDATES)
def test_beam_is_marginalised(case: Case, name: str) -> None:
    """The inverse of the information on everything holds the covariance of the effects with the beam free."""
    likelihood = Marginal(add_up([case]), BEAM, posterior_of(case)).likelihood([*ACTIVE, name])
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
    beam_response = -np.linalg.solve(information[:n_beam, :n_beam], information[:n_beam, n_beam:])
    if posterior.is_complex:
        beam_response = beam_response[:N_MODES] + 1j * beam_response[N_MODES:]
    np.testing.assert_allclose(Marginal(total, BEAM, posterior).response(ACTIVE), beam_response, atol=1e-10)


def test_score_at_the_best_beam_is_that_with_the_beam_free(case: Case) -> None:
    """The residual of the posterior mean needs no further marginalisation."""
    posterior = posterior_of(case)
    name = "by baseline"
    information, score = fisher(case, case.dense(name))
    n_beam = len(information) - PARAMETERS[name]
    taken = information[n_beam:, :n_beam] @ np.linalg.solve(information[:n_beam, :n_beam], score[:n_beam])
    fitted = (case.dense_design @ posterior.mean).reshape(case.block.shape)
    at_best = replace(case, block=replace(case.block, residual=case.block.residual - fitted))
    found = add_up([at_best]).likelihood_alone([name]).score
    np.testing.assert_allclose(found, score[n_beam:] - taken, atol=1e-9)


def assert_same_sums(one: NormalEquations, two: NormalEquations) -> None:
    for pair in one.gram:
        np.testing.assert_allclose(product(two, *pair), product(one, *pair), atol=1e-10)
    for name, total in one.projection.items():
        np.testing.assert_allclose(two.projection[name], total, atol=1e-10)


@pytest.mark.parametrize("how", ["times", "baselines", "both, and nothing"])
def test_sums_add_up_over_scenes(case: Case, how: str) -> None:
    n_times, n_bls = case.block.shape
    times, bls = np.arange(n_times), np.arange(n_bls)
    # Redundant baselines may be on different ranks.
    halves = {"times": [(times[:1], bls), (times[1:], bls)], "baselines": [(times, bls[::2]), (times, bls[1::2])]}
    tiles = halves.get(how, [(times[:2], bls), (times[2:], bls[:5]), (times[2:], bls[5:]), (times[:0], bls[:0])])
    assert_same_sums(add_up([case]), add_up([case.part(*tile) for tile in tiles]))


@pytest.mark.mpi
def test_sums_add_up_over_ranks(case: Case, comm: MPI.Comm) -> None:
    times, bls = np.array_split(np.arange(case.block.shape[0]), comm.size)[comm.rank], np.arange(case.block.shape[1])
    mine = add_up([case.part(times, bls)])
    mine.reduce(comm)
    assert_same_sums(add_up([case]), mine)


def test_flagged_rows_do_not_count(case: Case) -> None:
    spoilt = case.block.residual.copy()
    spoilt[case.block.weights == 0] = -1e9
    one = add_up([case])
    two = add_up([replace(case, block=replace(case.block, residual=spoilt))])
    for name, total in one.projection.items():
        np.testing.assert_array_equal(total, two.projection[name])
    nothing = add_up([replace(case, block=replace(case.block, weights=np.zeros(case.block.shape)))])
    assert not any(np.any(total) for total in (*nothing.gram.values(), *nothing.projection.values()))


def test_no_effects_are_no_trouble(case: Case) -> None:
    total = NormalEquations([Block(BEAM, N_MODES, np.iscomplexobj(case.design)), Block("none", 0)], [(BEAM, "none")])
    rows = row_set(case.block)
    columns = Columns(np.zeros((*case.block.shape, 0), dtype=complex), 0)
    total.add_rows({"none": effect_columns(rows, columns)}, {BEAM: beam_columns(rows, case.design)})
    likelihood = Marginal(total, BEAM, posterior_of(case)).likelihood([])
    assert likelihood.information.shape == (0, 0)
    assert Marginal(total, BEAM, posterior_of(case)).response([]).shape == (N_MODES, 0)


@pytest.mark.parametrize("kind", EFFECTS)
def test_beam_effects_and_candidates_are_blocks_alike(kind: str) -> None:
    """Their sums are those of dense derivatives, of an effect in the model and of a candidate."""
    effect, block, case = set_up(kind)
    setup, x = block.setup, draw(effect, block.setup, case.strengths[0])
    shape = (len(block.times), 2, len(block.groups), setup.basis.n_modes)
    block = replace(block, design=generator(5, "design").standard_normal(shape))
    active = Active.start(effect, setup, np.where(np.arange(len(x)) % 3 == 1, 0.0, 1.0), np.zeros((1, len(x))))
    values = Values((replace(active, x=np.tile(x, (setup.observation.Nfreqs, 1))),))
    (name,) = values.blocks
    prior = ChannelPrior((FlatPrior(np.zeros(setup.basis.n_modes)),))
    model: dict[str, ModelBlock] = {BEAM: BeamBlock(setup.basis, prior), **values.blocks}
    candidates = {"candidate": CandidateBlock(effect, x)}
    total = sums_of(model, candidates)
    add_block(total, block, model, candidates)
    columns = effect.columns(block, x)
    dense = np.asarray(columns.matrix() @ np.eye(len(x))).reshape(*columns.values.shape[:2], -1)
    dense = (block.spread(dense) if columns.by_group else dense).reshape(-1, len(x))
    beam = block.spread(block.design[:, 0] + 1j * block.design[:, 1]).reshape(-1, shape[-1])
    derivatives = {BEAM: beam, name: dense[:, active.used], "candidate": dense}
    weights = block.weights.reshape(-1, 1)
    for one, two in total.gram:
        expected = (derivatives[one].conj().T @ (weights * derivatives[two])).real
        np.testing.assert_allclose(total.gather([one], [two]), expected, atol=1e-10 * np.abs(expected).max())
    assert (name, "candidate") in total.gram
    assert (BEAM, BEAM) not in total.gram
    for one, found in total.projection.items():
        expected = ((weights * derivatives[one]).conj().T @ block.residual.reshape(-1)).real
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    for part in model.values():
        assert part.held.shape[1] == part.size == len(part.prior.of(0).mean)
