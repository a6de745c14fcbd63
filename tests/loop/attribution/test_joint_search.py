"""The search for effects that explain a residual together, on linear models whose truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.parameters import Parameters
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.evidence import price_of
from hydrabeam_mpi.loop.attribution.joint_likelihood import Competitor, JointLikelihood, State
from hydrabeam_mpi.loop.attribution.joint_search import JointSet, search
from hydrabeam_mpi.loop.attribution.others import Others
from hydrabeam_mpi.loop.attribution.weigh_together import with_strong_alone
from hydrabeam_mpi.random import generator

N_DATA, LEAST = 200, 5.0
NOTHING = Others(np.zeros(0, dtype=bool), (np.zeros((0, 0)),) * 2, (np.zeros(0),) * 2)


def competitor(n: int, elements: bool = False, shared: bool = False) -> Competitor:
    parameters = Parameters.of([f"p{i}" for i in range(n)], "", 1.0, np.arange(n) if elements else None)
    return Competitor(parameters, np.zeros((0, n)), shared)


class Data:
    """White noise of variance one in each channel, and what some columns add to it."""

    def __init__(self, columns: Sequence[FloatArray], competitors: Sequence[Competitor], signal: Sequence[FloatArray]):
        rng = generator(7, "joint search")
        self.columns, self.competitors = columns, competitors
        self.data = [one + rng.standard_normal(N_DATA) for one in signal]
        self.all = np.concatenate(columns, axis=1)
        information = self.all.T @ self.all
        by_channel = [Likelihood(information, self.all.T @ one, information) for one in self.data]
        model = Others(NOTHING.shared, NOTHING.precision[: len(signal)], NOTHING.score[: len(signal)])
        self.joint = JointLikelihood(by_channel, model, competitors)

    def found(self) -> JointSet:
        return search(self.joint, LEAST)

    def log_evidence(self, state: State) -> float:
        """By the density of all channels' data, with prices."""
        ends, n = np.cumsum([0, *(one.shape[1] for one in self.columns)]), len(self.data)
        covariance, price = np.eye(n * N_DATA), 0.0
        for i, one in state.items():
            part = self.all[:, ends[i] : ends[i + 1]]
            channels = np.ones((n, n)) if self.competitors[i].shared else np.eye(n)
            covariance += np.kron(channels, (part * one.prior_var) @ part.T)
            price += price_of(self.competitors[i].parameters, one.prior_var)
        data, zero = np.concatenate(self.data), np.zeros(n * N_DATA)
        with_set, without = (multivariate_normal.logpdf(data, zero, c) for c in (covariance, np.eye(n * N_DATA)))
        return float(with_set - without) - price


def draw(*shape: int, seed: int = 0) -> FloatArray:
    return generator(seed, "columns").standard_normal(shape)


@pytest.fixture
def stand_in() -> Data:
    """Two effects with columns that are alike, and one that nearly has their sum, which alone explains most."""
    common = draw(N_DATA, 1, seed=1)
    one, two = 0.5 * common + draw(N_DATA, 2, seed=2), 0.5 * common + draw(N_DATA, 2, seed=3)
    truth = one @ [1.0, -0.6] + two @ [0.9, 0.7]
    mimic = np.column_stack([truth + 0.4 * np.std(truth) * draw(N_DATA, seed=4), draw(N_DATA, 5, seed=5)])
    columns = [one, mimic, draw(N_DATA, 8, seed=6), two]
    return Data(columns, [competitor(2), competitor(6), competitor(8, elements=True), competitor(2)], [truth])


def test_what_is_best_and_simplest_has_none_beside_it(stand_in: Data) -> None:
    assert stand_in.found().simpler == ()


def test_what_is_right_together_takes_the_place_of_what_explains_most_alone(stand_in: Data) -> None:
    alone = stand_in.joint.weigh({}, range(4))
    assert max(alone, key=lambda i: alone[i].log_bayes_factor) == 1
    found = stand_in.found()
    assert set(found.order) == {0, 3}
    first, second = (found.beside[i][i].log_bayes_factor for i in found.order)
    assert first >= second > LEAST
    state = {i: found.beside[i][i] for i in found.order}
    assert found.log_bayes_factor == pytest.approx(stand_in.log_evidence(state), rel=1e-3)
    # Any other set has less evidence, and what could stand in the place of each has less than it has.
    for others in ([0, 1], [1, 3], [1], [0, 1, 3]):
        rest: State = {}
        for i in others:
            rest = {**rest, i: stand_in.joint.weigh(rest, [i])[i]}
        assert stand_in.log_evidence(rest) < found.log_bayes_factor
    for i in found.order:
        beside = {j: one.log_bayes_factor for j, one in found.beside[i].items()}
        assert set(beside) == {i, 1, 2}
        assert max(beside, key=lambda j: beside[j]) == i


def test_what_one_effect_explains_is_shared_out() -> None:
    """All elements of one stand for another and for one element, as positions of all antennas do for a wrong clock.

    Neither can be added beside all elements, and what has the most evidence in their place is not what is right.
    """
    each = draw(N_DATA, 12, seed=8)
    clock = each @ draw(12, 1, seed=9)
    part = 0.7 * clock + each[:, [4]] + 0.3 * np.std(clock) * draw(N_DATA, 1, seed=10)
    truth = 2 * clock[:, 0] + 6 * each[:, 4]
    competitors = [competitor(12, elements=True), competitor(1), competitor(1)]
    data = Data([each, clock + 0.01 * draw(N_DATA, 1, seed=11), part], competitors, [truth])
    alone = data.joint.weigh({}, range(3))
    assert sorted(alone, key=lambda i: -alone[i].log_bayes_factor) == [0, 2, 1]
    assert data.joint.weigh({0: alone[0]}, [1])[1].log_bayes_factor < LEAST
    found = data.found()
    assert set(found.order) == {0, 1}
    assert np.flatnonzero(found.beside[0][0].prior_var).tolist() == [4]
    assert found.log_bayes_factor > alone[0].log_bayes_factor + LEAST


def test_chi2_of_what_a_set_leaves(stand_in: Data) -> None:
    found = stand_in.found()
    state = {i: found.beside[i][i] for i in found.order}
    parts, widths = zip(*((stand_in.columns[i], one.prior_var) for i, one in state.items()), strict=True)
    part, widths = np.concatenate(parts, axis=1), np.concatenate(widths)
    x = np.linalg.solve(part.T @ part + np.diag(1 / widths), part.T @ stand_in.data[0])
    drop = np.sum(stand_in.data[0] ** 2) - np.sum((stand_in.data[0] - part @ x) ** 2)
    assert found.gain == stand_in.joint.gain(state) == pytest.approx(0.5 * drop, rel=1e-9)


def test_no_set_raises_the_likelihood_by_more_than_all_parameters_do(stand_in: Data) -> None:
    most, data = stand_in.joint.most_gain(), stand_in.data[0]
    residual = data - stand_in.all @ np.linalg.lstsq(stand_in.all, data, rcond=None)[0]
    assert most == pytest.approx(0.5 * (np.sum(data**2) - np.sum(residual**2)), rel=1e-9)
    # With fewer effects, and with priors, it rises by less.
    few, every = (stand_in.joint.gain(stand_in.joint.weigh({}, numbers)) for numbers in ([0], range(4)))
    assert few < every < most


def test_a_set_ends_where_a_control_model_is_wanted_beside_its_effects(stand_in: Data) -> None:
    one, two = stand_in.competitors[0], replace(stand_in.competitors[3], is_control=True)
    joint = replace(stand_in.joint, competitors=[one, *stand_in.competitors[1:3], two])
    assert search(joint, LEAST).order == (1,)
    assert joint.weigh(joint.weigh({}, [1]), [3])[3].log_bayes_factor > LEAST
    not_wanted = [one, stand_in.competitors[1], replace(stand_in.competitors[2], is_control=True), one]
    assert set(search(replace(stand_in.joint, competitors=not_wanted), LEAST).order) == {0, 3}


def test_strong_effects_are_told_without_what_may_be_of_them_that_is_not_linear() -> None:
    columns = [draw(N_DATA, 1, seed=seed) for seed in range(20, 24)]
    truth = np.concatenate(columns, axis=1) @ [30.0, -20.0, 0.9, 0.0]
    found = with_strong_alone(Data(columns, [competitor(1)] * 4, [truth]).joint, LEAST)
    assert found.order == (0, 1, 2)
    assert [one.order for one in found.simpler] == [(0, 1)]
    # Where all are strong there is one set.
    truth = np.concatenate(columns, axis=1) @ [30.0, -20.0, 9.0, 0.0]
    found = with_strong_alone(Data(columns, [competitor(1)] * 4, [truth]).joint, LEAST)
    assert found.order == (0, 1, 2)
    assert found.simpler == ()


def test_nothing_is_found_in_noise() -> None:
    data = Data(
        [draw(N_DATA, 3, seed=8), draw(N_DATA, 9, seed=9)], [competitor(3), competitor(9, True)], [np.zeros(N_DATA)]
    )
    found = data.found()
    assert found.order == ()
    assert found.log_bayes_factor == 0.0


def test_what_channels_share_beside_what_each_has_its_own() -> None:
    """The shared effect by the sum over channels; elements by those at fault."""
    shared, own = draw(N_DATA, 1, seed=10), draw(N_DATA, 6, seed=11) + 0.5 * draw(N_DATA, 1, seed=10)
    competitors = [competitor(6, elements=True), competitor(1, shared=True)]
    at_fault = np.zeros(6)
    at_fault[[1, 4]] = 1.0
    signal = [shared[:, 0] * 0.6 + own @ (sign * at_fault) for sign in (1.0, -1.0)]
    data = Data([own, shared], competitors, signal)
    found = data.found()
    assert set(found.order) == {0, 1}
    of_own, of_shared = found.beside[0][0], found.beside[1][1]
    assert np.flatnonzero(of_own.prior_var).tolist() == [1, 4]
    assert of_shared.x.shape == (1, 1)
    np.testing.assert_allclose(of_shared.x[0], 0.6, atol=4 / np.sqrt(2 * N_DATA))
    np.testing.assert_allclose(of_own.x[:, 1], [1.0, -1.0], atol=5 / np.sqrt(N_DATA))
    state = {i: found.beside[i][i] for i in found.order}
    # Each channel counts its part of the shared prior, and what they tell is not brought together before.
    assert found.log_bayes_factor == pytest.approx(data.log_evidence(state), abs=3.0)
    left = sum(one @ one for one in data.data) - 2 * data.joint.gain(state)
    assert left == pytest.approx(2 * N_DATA, abs=4 * np.sqrt(4 * N_DATA))


def test_best_values_of_own_and_shared_unknowns_solve_the_equations_of_all_channels() -> None:
    matrices = [draw(N_DATA, 3, seed=seed) for seed in (12, 13)]
    data = [draw(N_DATA, seed=seed) for seed in (14, 15)]
    by_channel = [Likelihood(one.T @ one, one.T @ d, one.T @ one) for one, d in zip(matrices, data, strict=True)]
    others = NOTHING.and_more(np.array([True, False, False]), np.array([0.3, 2.0, 0.1]))
    found = np.array(others.best(by_channel))
    whole = np.zeros((2 * N_DATA, 5))
    for channel, one in enumerate(matrices):
        rows = slice(channel * N_DATA, (channel + 1) * N_DATA)
        whole[rows, 0], whole[rows, 1 + 2 * channel : 3 + 2 * channel] = one[:, 0], one[:, 1:]
    precision = whole.T @ whole + np.diag(1 / np.array([0.3, 2.0, 0.1, 2.0, 0.1]))
    x = np.linalg.solve(precision, whole.T @ np.concatenate(data))
    np.testing.assert_allclose(found, [[x[0], x[1], x[2]], [x[0], x[3], x[4]]], rtol=1e-9)


@pytest.mark.parametrize("n_freqs", [1, 2])
def test_the_model_that_is_taken_out_once_is_as_beside_each_set(n_freqs: int) -> None:
    """Of what channels share of it, and of what each has its own, whose priors have gradients of their own."""
    shared, precision = np.array([True, False, False, True, True]), np.diag([0.5, 3.0, 1.0, 7.0, 0.1])
    precision[1, 2] = precision[2, 1] = 0.4
    scores = tuple(np.where(shared, 0.7, draw(5, seed=20 + f)) for f in range(n_freqs))
    model = Others(shared, (precision,) * n_freqs, scores)
    columns = draw(N_DATA, 9, seed=16) + draw(N_DATA, 1, seed=17)
    data = [draw(N_DATA, seed=18 + f) for f in range(n_freqs)]
    by_channel = [Likelihood(columns.T @ columns, columns.T @ one, columns.T @ columns) for one in data]
    joint = JointLikelihood(by_channel, model, [competitor(2, shared=True), competitor(2)])
    state = {0: joint.weigh({}, [0])[0]}
    for number, in_set in ((1, state), (0, {})):
        is_shared = joint.competitors[number].shared
        found = joint._beside(in_set, [number], is_shared)[0]
        others, order = model, [*range(5)]
        if in_set:
            used = np.flatnonzero(state[0].prior_var)
            others, order = (
                model.and_more(np.full(len(used), True), state[0].prior_var[used]),
                [*range(5), *(5 + used).tolist()],
            )
        which = np.array([*order, 7, 8] if number else [*order, 5, 6])
        square = np.ix_(which, which)
        whole = [Likelihood(one.information[square], one.score[which], one.signal[square]) for one in by_channel]
        for one, other in zip(found, others.marginalised(whole, is_shared), strict=True):
            np.testing.assert_allclose(one.information, other.information, rtol=1e-9)
            np.testing.assert_allclose(one.score, other.score, rtol=1e-9)
            np.testing.assert_array_equal(one.signal, other.signal)


def test_what_channels_share_is_as_in_one_matrix_of_all_channels() -> None:
    """Beside a set of which channels share one and each has the other its own, and a model that they share in part."""
    is_shared, precision = np.array([True, False, True]), np.diag([0.5, 3.0, 7.0])
    model = Others(is_shared, (precision,) * 2, tuple(np.where(is_shared, 0.7, draw(3, seed=f)) for f in (30, 31)))
    matrices = [draw(N_DATA, 9, seed=f) + 3 * draw(N_DATA, 1, seed=34) for f in (32, 33)]
    data = [draw(N_DATA, seed=f) for f in (35, 36)]
    by_channel = [Likelihood(m.T @ m, m.T @ d, m.T @ m) for m, d in zip(matrices, data, strict=True)]
    competitors = [competitor(2, shared=True), competitor(2), competitor(2, shared=True)]
    joint = JointLikelihood(by_channel, model, competitors)
    prior_var = np.array([0.3, 0.0]), np.array([0.2, 0.6])
    state = {i: replace(joint.weigh({}, [i])[i], prior_var=prior_var[i]) for i in (0, 1)}
    (found,) = joint._beside(state, [2], shared=True)[0]

    # Shared columns once, the others once a channel; the unused second one of the first competitor is left out.
    together, apart = [0, 2, 3, 7, 8], [1, 5, 6]
    whole = np.zeros((2 * N_DATA, 11))
    for channel, one in enumerate(matrices):
        rows = slice(channel * N_DATA, (channel + 1) * N_DATA)
        whole[rows, :5], whole[rows, 5 + 3 * channel : 8 + 3 * channel] = one[:, together], one[:, apart]
    of_prior = [0.5, 7.0, 1 / 0.3, 0, 0, *(2 * [3.0, 1 / 0.2, 1 / 0.6])]
    score = whole.T @ np.concatenate(data)
    score[[0, 1]] += 0.7
    score[[5, 8]] += [one[1] for one in model.score]
    information, own = whole.T @ whole + np.diag(of_prior), [3, 4]
    gone = np.setdiff1d(np.arange(11), own)
    seen = np.linalg.solve(information[np.ix_(gone, gone)], information[np.ix_(gone, own)])
    np.testing.assert_allclose(found.information, information[np.ix_(own, own)] - information[np.ix_(own, gone)] @ seen)
    np.testing.assert_allclose(found.score, score[own] - seen.T @ score[gone])
    np.testing.assert_allclose(found.signal, (whole.T @ whole)[np.ix_(own, own)])
