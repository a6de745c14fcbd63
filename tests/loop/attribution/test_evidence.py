"""Evidence against densities of the data themselves: d ~ N(0, noise + A C A^T + S T S^T), by brute force."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Parameters
from hydrabeam_mpi.loop.attribution.evidence import (
    TAUS,
    Evidence,
    Likelihood,
    evidence_of,
    find_evidence,
    price_of,
    solve,
)
from hydrabeam_mpi.random import generator

N_DATA, N_MODES = 40, 6


@dataclass(frozen=True)
class Model:
    """Real data y = A b + S x + n with b ~ N(0, 1) and white noise of variance one."""

    design: FloatArray
    columns: FloatArray
    data: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Of the data without the effect."""
        return np.eye(len(self.data)) + self.design @ self.design.T

    @property
    def likelihood(self) -> Likelihood:
        """By the Schur complement, as sums over rows give it."""
        across = self.design.T @ self.columns
        inverse = np.linalg.inv(np.eye(self.design.shape[1]) + self.design.T @ self.design)
        signal = self.columns.T @ self.columns
        residual = self.data - self.design @ (inverse @ (self.design.T @ self.data))
        return Likelihood(signal - across.T @ inverse @ across, self.columns.T @ residual, signal)

    def log_bayes_factor(self, prior_var: FloatArray) -> float:
        """Compare the density of the data with and without the effect."""
        with_effect = self.covariance + (self.columns * prior_var) @ self.columns.T
        zero = np.zeros(len(self.data))
        one, two = (multivariate_normal.logpdf(self.data, zero, c) for c in (with_effect, self.covariance))
        return float(one - two)

    def without(self, combinations: FloatArray) -> Model:
        """Keep what is orthogonal to combinations of the columns, in units in which the data are white."""
        white = np.linalg.inv(np.linalg.cholesky(self.covariance))
        kept = null_space((white @ self.columns @ combinations.T).T).T @ white
        return Model(np.zeros((len(kept), 1)), kept @ self.columns, kept @ self.data)


def make_model(n_params: int, seed: int, x: FloatArray | None = None, size: float = 1.0) -> Model:
    rng = generator(seed, "evidence")
    design = rng.standard_normal((N_DATA, N_MODES))
    columns = size * rng.standard_normal((N_DATA, n_params))
    data = design @ rng.standard_normal(N_MODES) + rng.standard_normal(N_DATA)
    return Model(design, columns, data if x is None else data + columns @ x)


def of_one_element(n: int, scale: FloatArray | float = 1.0) -> Parameters:
    return Parameters.of([f"p{i}" for i in range(n)], "", scale)


def of_elements(n: int, each: int, trials: int | None = None, scale: FloatArray | float = 1.0) -> Parameters:
    names = [f"p{i}" for i in range(n * each)]
    return Parameters.of(names, "", scale, np.repeat(np.arange(n), each), trials=trials)


def brute_force(models: list[Model], prior_var: FloatArray) -> float:
    return sum(model.log_bayes_factor(prior_var) for model in models)


def taken_elements(evidence: Evidence, parameters: Parameters) -> list[int]:
    return np.unique(parameters.element[evidence.prior_var > 0]).tolist()


@pytest.mark.parametrize("n_blocks", [1, 3])
def test_dense_prior(n_blocks: int) -> None:
    scale = np.array([1.0, 0.2, 30.0])
    models = [make_model(3, seed, x=0.5 * scale, size=0.3) for seed in range(n_blocks)]
    found = find_evidence([model.likelihood for model in models], of_one_element(3, scale))
    widths = np.sqrt(found.prior_var) / scale
    tau = widths[0]
    np.testing.assert_allclose(widths, tau)
    assert found.log_bayes_factor == pytest.approx(brute_force(models, found.prior_var) - 1, rel=1e-9)
    # No other width of the same kind does better, but for the steps of one sixth between widths: less than 0.1 nats.
    others = [brute_force(models, (factor * tau * scale) ** 2) for factor in (*np.linspace(0.5, 2, 40), 1e-3, 1e3)]
    assert max(others) < found.log_bayes_factor + 1 + 0.1
    assert found.n_parameters == 3 * n_blocks
    assert found.rank == 3 * n_blocks


def test_what_follows_from_the_prior() -> None:
    model = make_model(4, 5, x=np.array([2.0, -1.0, 0.5, 0.0]))
    found = find_evidence([model.likelihood], of_one_element(4))
    inverse = np.linalg.inv(model.covariance)
    gain = (found.prior_var[:, np.newaxis] * model.columns.T) @ np.linalg.inv(
        model.covariance + (model.columns * found.prior_var) @ model.columns.T
    )
    x = gain @ model.data
    np.testing.assert_allclose(found.x[0], x, rtol=1e-9)
    left = model.data - model.columns @ x
    drop = model.data @ inverse @ model.data - left @ inverse @ left
    assert found.chi2_drop == pytest.approx(drop, rel=1e-9)
    assert found.linear_gain == pytest.approx(0.5 * drop - 0.5 * np.sum(x**2 / found.prior_var), rel=1e-9)
    assert found.effective_parameters == pytest.approx(np.trace(gain @ model.columns), rel=1e-9)
    signature = model.columns @ x
    seen = signature @ inverse @ signature
    assert found.absorbed == pytest.approx(1 - seen / (signature @ signature), rel=1e-9)
    assert 0.02 < found.absorbed < 0.98


def test_an_effect_like_the_beam_is_absorbed() -> None:
    rng = generator(2, "absorbed")
    design = 1e3 * rng.standard_normal((N_DATA, N_MODES))
    columns = design @ rng.standard_normal((N_MODES, 2))
    model = Model(design, columns, rng.standard_normal(N_DATA) + columns @ np.array([0.1, 0.1]))
    found = find_evidence([model.likelihood], of_one_element(2))
    assert found.absorbed > 0.999
    assert found.log_bayes_factor < 0


@pytest.mark.parametrize("n_blocks", [1, 2])
@pytest.mark.parametrize(("each", "trials"), [(1, None), (2, None), (2, 300)])
def test_sparse_prior(each: int, trials: int | None, n_blocks: int) -> None:
    parameters = of_elements(10, each, trials, scale=np.linspace(0.5, 2, 10 * each))
    x = np.where(np.isin(parameters.element, [3, 7]), 3.0, 0.0)
    models = [make_model(10 * each, 20 + seed, x) for seed in range(n_blocks)]
    found = find_evidence([model.likelihood for model in models], parameters)
    assert taken_elements(found, parameters) == [3, 7]
    np.testing.assert_allclose(found.x, np.broadcast_to(x, found.x.shape), atol=1.0)
    # Two of so many elements in any order, and two widths found from the data.
    n = trials or 10
    price = np.log(n * (n - 1) / 2) + 2
    assert found.log_bayes_factor == pytest.approx(brute_force(models, found.prior_var) - price, rel=1e-9)
    assert found.n_parameters == 2 * each * n_blocks


def test_few_among_many() -> None:
    """Thirty elements at fault in a hundred data, three of them grossly."""
    rng = generator(4, "few among many")
    columns = rng.standard_normal((100, 60))
    parameters = of_elements(30, 2)
    x = np.zeros(60)
    x[[8, 9, 31, 44]] = 4.0, -3.0, 3.0, -5.0
    model = Model(rng.standard_normal((100, N_MODES)), columns, columns @ x + rng.standard_normal(100))
    found = find_evidence([model.likelihood], parameters)
    assert taken_elements(found, parameters) == [4, 15, 22]
    dense = model.log_bayes_factor(np.full(60, np.mean(x**2)))
    assert found.log_bayes_factor > dense + 5
    _, (covariance,) = solve([model.likelihood], found.prior_var)
    used = found.prior_var > 0
    assert np.all(np.abs(found.x[0] - x)[used] < 4 * np.sqrt(np.diag(covariance)[used]))


@pytest.mark.parametrize(
    ("parameters", "at_fault", "n_picked"),
    [
        pytest.param(of_elements(6, 1), [0, 3], 2, id="two of six"),
        pytest.param(of_elements(6, 1), range(6), 1, id="all that there are"),
        pytest.param(of_elements(2, 3, trials=300), [0, 1], 2, id="two of a scan of many"),
        pytest.param(of_one_element(6), [0], 1, id="a single one"),
    ],
)
def test_of_elements_that_were_picked_one_alone_costs_its_part(
    parameters: Parameters, at_fault: Iterable[int], n_picked: int
) -> None:
    x = np.where(np.isin(parameters.element, list(at_fault)), 4.0, 0.0)
    model = make_model(6, 7, x)
    found = find_evidence([model.likelihood], parameters)
    assert len(taken_elements(found, parameters)) == len(list(at_fault))
    assert found.price > 0
    assert found.n_picked == n_picked
    assert found.least_price == pytest.approx(found.price / n_picked)
    assert evidence_of([model.likelihood], parameters, found.prior_var).n_picked == n_picked


def test_what_a_fit_gains_counts_at_the_same_price() -> None:
    found = find_evidence([make_model(3, 2, np.full(3, 2.0)).likelihood], of_one_element(3))
    fitted = found.with_gain(found.linear_gain + 7.0)
    assert fitted.log_bayes_factor == pytest.approx(found.log_bayes_factor + 7.0)
    assert fitted.price == pytest.approx(found.price)
    both = found.with_others([fitted])
    assert both.log_bayes_factor == pytest.approx(found.log_bayes_factor + fitted.log_bayes_factor)
    assert both.price == pytest.approx(2 * found.price)
    assert both.effective_parameters == pytest.approx(2 * found.effective_parameters)


def test_all_at_fault_is_no_few() -> None:
    rng = generator(6, "all at fault")
    columns = rng.standard_normal((100, 20))
    model = Model(np.zeros((100, 1)), columns, columns @ rng.standard_normal(20) + rng.standard_normal(100))
    found = find_evidence([model.likelihood], of_elements(20, 1))
    assert np.all(found.prior_var > 0)
    assert np.ptp(found.prior_var) < 1e-12 * found.prior_var[0]
    assert found.log_bayes_factor == pytest.approx(model.log_bayes_factor(found.prior_var) - 1, rel=1e-9)


def test_several_of_a_scan_are_sparse_whatever_they_are() -> None:
    """Those that a scan picked are at fault one by one: what they have in common was chosen, not found."""
    parameters = of_elements(5, 1, trials=500)
    model = make_model(5, 8)
    found = find_evidence([model.likelihood], parameters)
    assert len(taken_elements(found, parameters)) == 1
    price = np.log(500) + 1
    assert found.log_bayes_factor == pytest.approx(model.log_bayes_factor(found.prior_var) - price, rel=1e-9)


@pytest.mark.parametrize("n_blocks", [1, 2])
def test_undecidable_combinations_decide_nothing(n_blocks: int) -> None:
    combination = np.ones((1, 4)) / 2
    x = np.array([0.7, -0.4, 0.0, 0.2])
    models = [make_model(4, 30 + seed, x) for seed in range(n_blocks)]
    moved = [Model(one.design, one.columns, one.data + 1e3 * one.columns.sum(axis=1)) for one in models]
    found, other = (
        find_evidence([model.likelihood for model in some], of_one_element(4), combination) for some in (models, moved)
    )
    assert other.log_bayes_factor == pytest.approx(found.log_bayes_factor, rel=1e-6)
    reduced = [model.without(combination) for model in models]
    assert found.log_bayes_factor == pytest.approx(brute_force(reduced, found.prior_var) - 1, rel=1e-6)
    assert found.rank == 3 * n_blocks


def test_what_is_free_is_not_held_against_few_elements() -> None:
    """One antenna of five that is off from the others is one antenna, wherever all of them are."""
    combination = np.ones((1, 5)) / np.sqrt(5)
    model = make_model(5, 12, np.array([2.0, 2.0, 5.0, 2.0, 2.0]))
    parameters = of_elements(5, 1)
    found = find_evidence([model.likelihood], parameters, combination)
    assert taken_elements(found, parameters) == [2]
    assert found.x[0, 2] == pytest.approx(3.0, abs=1.0)
    reduced = model.without(combination)
    price = np.log(5) + 1
    assert found.log_bayes_factor == pytest.approx(reduced.log_bayes_factor(found.prior_var) - price, rel=1e-6)


@pytest.mark.parametrize("each", [1, 2, 6])
def test_columns_that_are_the_same_or_zero(each: int) -> None:
    """A singular information is no obstacle, and its rank is told."""
    model = make_model(6, 14, np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0]))
    columns = model.columns.copy()
    columns[:, 4], columns[:, 5] = columns[:, 1], 0.0
    model = Model(model.design, columns, model.data)
    parameters = of_elements(6 // each, each)
    found = find_evidence([model.likelihood], parameters)
    assert found.rank == 4
    # Either one width for all, or one element of several, whose price is higher.
    n_elements = len(np.unique(parameters.element))
    sparse = len(taken_elements(found, parameters)) == 1 < n_elements
    price = 1 + sparse * np.log(n_elements)
    assert found.log_bayes_factor == pytest.approx(model.log_bayes_factor(found.prior_var) - price, rel=1e-7)
    assert np.all(np.isfinite(found.x))


@pytest.mark.parametrize("trials", [1, 3, 100])
def test_no_columns_at_all_are_no_evidence(trials: int) -> None:
    nothing = Likelihood(np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)))
    found = find_evidence([nothing, nothing], of_elements(3, 1, trials=max(trials, 3)), np.ones((1, 3)))
    assert found.log_bayes_factor <= 0
    assert found.rank == 0
    assert found.chi2_drop == 0
    assert found.absorbed == 0
    assert not np.any(found.x)


def test_refined_parameters_have_no_part() -> None:
    model = make_model(4, 16, np.array([3.0, 0.0, 0.0, 0.0]))
    full = Parameters.of("abcd", "", 1.0, [0, 0, 1, 1], [False, True, False, True])
    found = find_evidence([model.likelihood], full)
    assert not np.any(found.prior_var[[1, 3]])
    keep = np.array([0, 2])
    without = Model(model.design, model.columns[:, keep], model.data)
    alone = find_evidence([without.likelihood], Parameters.of("ac", "", 1.0, [0, 1]))
    assert found.log_bayes_factor == pytest.approx(alone.log_bayes_factor, rel=1e-12)
    np.testing.assert_allclose(found.prior_var[keep], alone.prior_var, rtol=1e-12)


def test_elements_without_a_scale_are_never_taken() -> None:
    """They are part of the model already."""
    parameters = of_elements(4, 2, scale=np.array([1, 1, 0, 0, 1, 1, 1, 1.0]))
    model = make_model(8, 18, np.array([0, 0, 9, 9, 2, 2, 0, 0.0]))
    found = find_evidence([model.likelihood], parameters)
    assert 1 not in taken_elements(found, parameters)


def test_units_do_not_matter() -> None:
    model = make_model(6, 22, np.array([3.0, 1, 0, 0, 0, 0]))
    unit = np.array([1e-9, 1e-9, 1e6, 1e6, 1, 1])
    other = Model(model.design, model.columns / unit, model.data)
    one = find_evidence([model.likelihood], of_elements(3, 2))
    two = find_evidence([other.likelihood], of_elements(3, 2, scale=unit))
    assert two.log_bayes_factor == pytest.approx(one.log_bayes_factor, rel=1e-6)
    np.testing.assert_allclose(two.x / unit, one.x, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize(
    "parameters", [of_elements(20, 1), of_elements(10, 2), of_one_element(20)], ids=["20", "10 of 2", "1 of 20"]
)
def test_noise_is_no_evidence(parameters: Parameters) -> None:
    """Of 200 draws of noise alone hardly one reaches five nats, and the mean is on the other side."""
    models = [make_model(20, 1000 + seed) for seed in range(200)]
    found = np.array([find_evidence([model.likelihood], parameters).log_bayes_factor for model in models])
    assert np.sum(found > 5) <= 1
    assert np.sum(found > 2) <= 10
    assert np.mean(found) < -0.5


def test_the_best_of_a_scan_of_noise_is_no_evidence() -> None:
    """The five best of 400 candidates, as a scan picks them."""
    found = []
    for seed in range(200):
        rng = generator(seed, "scan of noise")
        columns, data = rng.standard_normal((N_DATA, 400)), rng.standard_normal(N_DATA)
        best = np.argsort(-np.abs(columns.T @ data) / np.linalg.norm(columns, axis=0))[:5]
        model = Model(np.zeros((N_DATA, 1)), columns[:, best], data)
        found.append(find_evidence([model.likelihood], of_elements(5, 1, trials=400)).log_bayes_factor)
    assert np.sum(np.array(found) > 5) <= 1
    assert np.mean(found) < 0


def test_solve_takes_units_far_apart() -> None:
    model = make_model(3, 24)
    prior_var = np.array([1e-20, 0.0, 1e20])
    means, (covariance,) = solve([model.likelihood], prior_var)
    used = [0, 2]
    precision = model.likelihood.information[np.ix_(used, used)] + np.diag(1 / prior_var[used])
    np.testing.assert_allclose(covariance[np.ix_(used, used)] @ precision, np.eye(2), atol=1e-6)
    np.testing.assert_allclose(means[0], covariance @ model.likelihood.score)
    assert not np.any(covariance[1])
    assert not np.any(means[:, 1])


def test_widths_reach_far() -> None:
    """Parameters may be a millionth of their natural size, or far beyond it."""
    for size in (1e-5, 1e2):
        model = make_model(3, 26, np.full(3, 1.0), size=10)
        scaled = Model(model.design, model.columns / size, model.data)
        found = find_evidence([scaled.likelihood], of_one_element(3))
        assert found.log_bayes_factor > 10
        assert TAUS[0] ** 2 < found.prior_var[0] < TAUS[-1] ** 2
        assert np.sqrt(found.prior_var[0]) == pytest.approx(size, rel=0.8)


def test_nested_elements_have_no_gaps() -> None:
    """What is zero by itself may be anything between two that are not, and costs what evidence it costs."""
    x = np.array([3.0, -2.0, 0.0, 0.0, 0.5, 0.7, 0.0, 0.0])
    model, parameters = make_model(8, 5, x), of_elements(4, 2)
    apart = find_evidence([model.likelihood], parameters)
    together = find_evidence([model.likelihood], replace(parameters, nested=True))
    assert taken_elements(apart, parameters) == [0, 2]
    assert taken_elements(together, parameters) == [0, 1, 2]
    first, between, last = together.prior_var[[0, 2, 4]]
    assert between == pytest.approx(np.sqrt(first * last))
    differ = together.log_bayes_factor - apart.log_bayes_factor
    assert differ < 0
    expected = model.log_bayes_factor(together.prior_var) - model.log_bayes_factor(apart.prior_var)
    assert differ == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_combinations_that_do_nothing_are_no_information(seed: int) -> None:
    """Two antennas displaced alike, where there is one baseline: what the sums have of it is rounding.

    Marginalised like information it would take away, or add, as much as the data tell.
    """
    one = 300 * generator(seed, "rounding").standard_normal((12, 3))
    columns, x = np.hstack([one, -one]), np.repeat([0.5, -0.5], 3)
    block = Likelihood(columns.T @ columns, columns.T @ (columns @ x), columns.T @ columns)
    alike = np.hstack([np.eye(3), (1 + np.finfo(float).eps) * np.eye(3)])
    largest = block.signal.max()
    np.testing.assert_allclose(block.freed(alike).information, block.information, atol=1e-9 * largest)
    evidence = find_evidence([block], of_elements(2, 3), alike)
    np.testing.assert_allclose(evidence.x[0, :3] - evidence.x[0, 3:], np.ones(3), rtol=1e-4)


@pytest.mark.parametrize("rare_above", [1e-3, 1e3])
def test_elements_larger_than_any_that_is_expected_cost_their_rarity(rare_above: float) -> None:
    """Counts fall as the power -3/2 of the size; what is within them costs what it did, and has the same width."""
    parameters = of_elements(5, 1, trials=50)
    model = make_model(5, 3, x=np.array([0.0, 40.0, 0.0, 0.0, 0.0]))
    usual = find_evidence([model.likelihood], parameters)
    rare = replace(parameters, rare_above=rare_above)
    found = find_evidence([model.likelihood], rare)
    assert taken_elements(found, rare) == taken_elements(usual, parameters) == [1]
    width = float(np.sqrt(found.prior_var.max()))
    rarity = 1.5 * max(np.log(width / rare_above), 0.0)
    assert price_of(rare, found.prior_var) == pytest.approx(price_of(parameters, found.prior_var) + rarity)
    price = price_of(rare, found.prior_var)
    assert found.log_bayes_factor == pytest.approx(brute_force([model], found.prior_var) - price, rel=1e-9)
    if rare_above > 40:
        assert found.log_bayes_factor == usual.log_bayes_factor
    else:
        assert width < float(np.sqrt(usual.prior_var.max()))
    # All alike in the dense prior, each at its price.
    dense = np.full(5, 4.0)
    alike = of_elements(5, 1)
    assert price_of(replace(alike, rare_above=0.5), dense) == pytest.approx(1 + 5 * 1.5 * np.log(4))


def of_two_sorts(n: int) -> Parameters:
    return replace(of_elements(n, each=2), sort=np.tile([0, 1], n))


@pytest.mark.parametrize("few", [False, True])
def test_a_sort_that_is_zero_in_all_elements_is_left_out(few: bool) -> None:
    """Its numbers would cost what the data tell of them; that it was chosen costs ln 2."""
    n = 6
    x = np.zeros((n, 2))
    x[: 2 if few else n, 0] = 3.0
    model = make_model(2 * n, seed=8, x=x.ravel())
    parameters = of_two_sorts(n)
    found, of_all = (find_evidence([model.likelihood], one) for one in (parameters, replace(parameters, sort=None)))
    assert np.array_equal(found.prior_var > 0, x.ravel() > 0)
    assert found.log_bayes_factor > of_all.log_bayes_factor + 2
    price = price_of(parameters, found.prior_var)
    assert found.log_bayes_factor == pytest.approx(model.log_bayes_factor(found.prior_var) - price)
    amplitudes = replace(parameters, scale=np.tile([1.0, 0.0], n), sort=None)
    assert price == pytest.approx(np.log(2) + price_of(amplitudes, found.prior_var))


def test_sorts_that_are_both_there_are_both_told() -> None:
    model = make_model(12, seed=9, x=np.tile([3.0, -2.0], 6))
    found, of_all = (
        find_evidence([model.likelihood], one) for one in (of_two_sorts(6), replace(of_two_sorts(6), sort=None))
    )
    assert found.log_bayes_factor == of_all.log_bayes_factor
    assert (found.prior_var > 0).all()


def test_sorts_of_noise_are_no_evidence() -> None:
    found = [find_evidence([make_model(12, seed).likelihood], of_two_sorts(6)) for seed in range(40)]
    assert max(one.log_bayes_factor for one in found) < 5
