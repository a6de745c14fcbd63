"""Blocks of every kind in one set of sums: conditionals, marginals, draws and evidence against dense algebra."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import csr_array
from scipy.stats import multivariate_normal

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.equations import NormalEquations
from hydrabeam_mpi.inference.gaussian import Block, Gaussian
from hydrabeam_mpi.inference.prior import CovariancePrior, DiagonalPrior, FlatPrior, Prior
from hydrabeam_mpi.random import complex_normal, generator

N_TIMES, N_BLS, N_GROUPS = 4, 9, 4
MEMBER = (np.arange(N_TIMES)[:, None] * N_GROUPS + np.array([0, 0, 0, 1, 1, 2, 2, 3, 3])).reshape(-1)
N_ROWS = len(MEMBER)
SIZES = {"beam": 5, "gains": 4, "sky": 3, "voltages": 2, "diffuse": 6}
BY_GROUP = {"beam", "sky"}
CASES = [
    {"beam": False, "gains": False, "sky": False, "diffuse": False},
    {"beam": True, "voltages": True},
    {"beam": True, "gains": False, "sky": False},
    {"beam": False, "gains": False, "voltages": True, "diffuse": False},
]


class Model:
    """Data, and the columns of blocks whose unknowns ``are_complex`` or not, dense for the reference."""

    def __init__(self, are_complex: Mapping[str, bool]) -> None:
        rng = generator(4, "blocks", str(are_complex))
        self.blocks = [Block(name, SIZES[name], is_complex) for name, is_complex in are_complex.items()]
        self.weights = rng.uniform(0.5, 3, N_ROWS)
        self.weights[[2, 11]] = 0.0
        self.data = complex_normal(rng, (N_ROWS,))
        self.values, self.priors, means, covariances = {}, {}, [], []
        for one in self.blocks:
            n_rows = N_TIMES * N_GROUPS if one.name in BY_GROUP else N_ROWS
            self.values[one.name] = complex_normal(rng, (n_rows, one.size))
            if one.name == "gains":
                self.values[one.name] *= rng.random((n_rows, one.size)) < 0.4
            mean, covariance = self._prior_of(one, rng)
            means.append(as_real(mean))
            covariances.append(covariance)
        self.mean = np.concatenate(means)
        self.covariance = np.zeros((len(self.mean), len(self.mean)))
        for one, covariance in zip(self.blocks, covariances, strict=True):
            span = self.span(one.name)
            self.covariance[span, span] = covariance

    def _prior_of(self, one: Block, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Give a block a prior; return its mean, and its covariance in real and imaginary parts."""
        mean = complex_normal(rng, (one.size,)) if one.is_complex else rng.standard_normal(one.size)
        if one.name == "sky":
            sigma = rng.uniform(0.5, 2, one.size)
            self.priors[one.name] = DiagonalPrior(mean, sigma)
            return mean, np.diag(sigma**2)
        root = complex_normal(rng, (one.size, 9)) if one.is_complex else rng.standard_normal((one.size, 9))
        covariance = root @ root.conj().T
        self.priors[one.name] = CovariancePrior(mean, covariance)
        if not one.is_complex:
            return mean, covariance
        return mean, 0.5 * np.block([[covariance.real, -covariance.imag], [covariance.imag, covariance.real]])

    def span(self, name: str) -> slice:
        """Rows of a block in the reference, which has real and imaginary parts."""
        start = 0
        for one in self.blocks:
            stop = start + one.size * (1 + one.is_complex)
            if one.name == name:
                return slice(start, stop)
            start = stop
        raise KeyError(name)

    def equations(self, rows: np.ndarray) -> NormalEquations:
        """Sum over some of the rows, in the forms that each block may have them in."""
        total = NormalEquations(self.blocks)
        member = MEMBER[rows]
        of_rows = RowSet(self.weights[rows] * self.data[rows], self.weights[rows], member, N_TIMES * N_GROUPS)
        columns = {}
        for one in self.blocks:
            values = self.values[one.name]
            if one.name == "beam" and not one.is_complex:
                values = np.stack([values.real, values.imag])
            elif one.name not in BY_GROUP:
                values = values[rows]
            values = csr_array(values) if one.name == "gains" else values
            columns[one.name] = Columns(of_rows, values, one.name in BY_GROUP)
        total.add_data(self.data[rows], self.weights[rows])
        total.add_rows(columns)
        return total

    def dense(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return real columns, data and weights of all rows with weight, real parts before imaginary ones."""
        parts = []
        for one in self.blocks:
            values = self.values[one.name][MEMBER] if one.name in BY_GROUP else self.values[one.name]
            parts += [values, 1j * values] if one.is_complex else [values]
        used = self.weights > 0
        columns, data = np.concatenate(parts, axis=1)[used], self.data[used]
        stacked = np.concatenate([columns.real, columns.imag])
        return stacked, np.concatenate([data.real, data.imag]), 2 * np.tile(self.weights[used], 2)

    def posterior(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of everything."""
        columns, data, weights = self.dense()
        inverse = np.linalg.inv(self.covariance)
        covariance = np.linalg.inv(columns.T @ (weights[:, None] * columns) + inverse)
        return covariance @ (columns.T @ (weights * data) + inverse @ self.mean), covariance


def as_real(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag]) if np.iscomplexobj(values) else values


@pytest.fixture(params=CASES, ids=lambda case: ", ".join(f"{'complex ' * c}{name}" for name, c in case.items()))
def model(request: pytest.FixtureRequest) -> Model:
    return Model(request.param)


def summed(model: Model, comm: MPI.Comm) -> NormalEquations:
    """Each rank sums its rows; with three ranks one has none."""
    share = np.array_split(np.arange(N_ROWS), max(comm.size - 1, 1))
    total = model.equations(share[comm.rank] if comm.rank < len(share) else np.zeros(0, dtype=int))
    total.reduce(comm)
    return total


@pytest.mark.mpi
def test_joint_posterior_and_evidence(model: Model, comm: MPI.Comm) -> None:
    gaussian = summed(model, comm).gaussian(model.priors)
    posterior = gaussian.solve()
    mean, _ = model.posterior()
    for name, values in gaussian.values(posterior.mean).items():
        np.testing.assert_allclose(as_real(values), mean[model.span(name)], atol=1e-9)
    columns, data, weights = model.dense()
    marginal = columns @ model.covariance @ columns.T + np.diag(1 / weights)
    expected = multivariate_normal.logpdf(data, columns @ model.mean, marginal)
    assert posterior.log_evidence == pytest.approx(expected, rel=1e-9)
    assert gaussian.log_evidence() == pytest.approx(expected, rel=1e-9)


@pytest.mark.mpi
def test_any_block_can_be_marginalised(model: Model, comm: MPI.Comm) -> None:
    gaussian = summed(model, comm).gaussian(model.priors)
    mean, covariance = model.posterior()
    for out in [one.name for one in model.blocks]:
        rest = gaussian.marginalise([out])
        posterior = rest.solve()
        kept = np.delete(np.arange(len(mean)), np.arange(len(mean))[model.span(out)])
        found = np.concatenate([as_real(values) for values in rest.values(posterior.mean).values()])
        np.testing.assert_allclose(found, mean[kept], atol=1e-9)
        expected = covariance[np.ix_(kept, kept)]
        if posterior.is_complex:
            np.testing.assert_allclose(posterior.covariance, complex_covariance(rest.blocks, expected), atol=1e-9)
        else:
            np.testing.assert_allclose(posterior.covariance, expected, atol=1e-9)
        assert posterior.log_evidence == pytest.approx(gaussian.solve().log_evidence, rel=1e-9)


def complex_covariance(blocks: tuple[Block, ...], covariance: np.ndarray) -> np.ndarray:
    """Return E x x^H of complex unknowns from the covariance of their parts, block after block."""
    rows, start = [], 0
    for one in blocks:
        line = np.zeros((one.size, len(covariance)), dtype=complex)
        line[:, start : start + one.size] = np.eye(one.size)
        line[:, start + one.size : start + 2 * one.size] = 1j * np.eye(one.size)
        rows.append(line)
        start += 2 * one.size
    combine = np.concatenate(rows)
    return combine @ covariance @ combine.conj().T


@pytest.mark.mpi
def test_any_block_can_be_known(model: Model, comm: MPI.Comm) -> None:
    """The conditional of the others, and the density of the known one, which together are the joint."""
    gaussian = summed(model, comm).gaussian(model.priors)
    mean, covariance = model.posterior()
    rng = generator(5, "known")
    for one in model.blocks:
        value = complex_normal(rng, (one.size,)) if one.is_complex else rng.standard_normal(one.size)
        conditional = gaussian.condition({one.name: value})
        posterior = conditional.solve()
        span = model.span(one.name)
        on = np.arange(len(mean))[span]
        kept = np.delete(np.arange(len(mean)), on)
        expected, _ = known(mean, covariance, kept, on, value)
        found = np.concatenate([as_real(values) for values in conditional.values(posterior.mean).values()])
        np.testing.assert_allclose(found, expected, atol=1e-8)
        # p(known | d) = p(d, known) / p(d)
        density = multivariate_normal.logpdf(as_real(value), mean[on], covariance[np.ix_(on, on)])
        assert posterior.log_evidence - gaussian.solve().log_evidence == pytest.approx(density, rel=1e-8, abs=1e-8)


@pytest.mark.mpi
def test_any_pair_of_blocks(model: Model, comm: MPI.Comm) -> None:
    """Their marginal, in which one may be known, and their conditional given all others."""
    gaussian = summed(model, comm).gaussian(model.priors)
    mean, covariance = model.posterior()
    rows, names = np.arange(len(mean)), [one.name for one in model.blocks]
    at = gaussian.draw(generator(8, "others"))
    for one, two in permutations(names, 2):
        pair, others = np.concatenate([rows[model.span(one)], rows[model.span(two)]]), {*names} - {one, two}
        marginal = gaussian.marginalise(others)
        check_moments(marginal, (one, two), mean[pair], covariance[np.ix_(pair, pair)])
        first, second = rows[model.span(one)], rows[model.span(two)]
        check_moments(marginal.condition({two: at[two]}), (one,), *known(mean, covariance, first, second, at[two]))
        rest = np.delete(rows, pair)
        values = np.concatenate([np.zeros(0), *(as_real(at[name]) for name in names if name in others)])
        conditional = gaussian.condition({name: at[name] for name in others})
        check_moments(conditional, (one, two), *known(mean, covariance, pair, rest, values))


def known(
    mean: np.ndarray, covariance: np.ndarray, kept: np.ndarray, on: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of some unknowns where others have values."""
    slope = covariance[np.ix_(kept, on)] @ np.linalg.inv(covariance[np.ix_(on, on)])
    center = mean[kept] + slope @ (as_real(values) - mean[on])
    return center, covariance[np.ix_(kept, kept)] - slope @ covariance[np.ix_(on, kept)]


def check_moments(gaussian: Gaussian, names: tuple[str, ...], mean: np.ndarray, covariance: np.ndarray) -> None:
    """Compare with dense mean and covariance of the parts of these blocks, in this order."""
    blocks = tuple(one for name in names for one in gaussian.blocks if one.name == name)
    ordered = Gaussian(blocks, 0 * gaussian.precision, 0 * gaussian.source, 0.0) * gaussian
    center, spread = ordered.moments
    found = np.concatenate([as_real(values) for values in ordered.values(center).values()])
    np.testing.assert_allclose(found, mean, atol=1e-8)
    expected = complex_covariance(blocks, covariance) if ordered.is_complex else covariance
    np.testing.assert_allclose(spread, expected, atol=1e-8)


@pytest.mark.mpi
def test_products_are_of_all_that_is_known(model: Model, comm: MPI.Comm) -> None:
    """The halves of the data, of which one has the priors; with the density of both together."""
    whole = summed(model, comm).gaussian(model.priors)
    flat: dict[str, Prior] = {one.name: FlatPrior(np.zeros(one.size)) for one in reversed(model.blocks)}
    halves = np.arange(N_ROWS // 2), np.arange(N_ROWS // 2, N_ROWS)
    product = model.equations(halves[0]).gaussian(model.priors) * model.equations(halves[1]).gaussian(flat)
    np.testing.assert_allclose(product.precision, whole.precision, atol=1e-9)
    np.testing.assert_allclose(product.source, whole.source, atol=1e-9)
    assert product.log_scale is None
    squared = whole * whole
    assert squared.log_scale == pytest.approx(2 * whole.log_scale)


def test_what_is_known_elsewhere_of_some_blocks(model: Model) -> None:
    """As the moments of everything in one matrix."""
    here = model.equations(np.arange(N_ROWS // 2)).gaussian(model.priors)
    there = model.equations(np.arange(N_ROWS // 2, N_ROWS)).gaussian(model.priors)
    for name in (one.name for one in model.blocks):
        others = {one.name for one in model.blocks} - {name}
        elsewhere = there.marginalise(others)
        mean, covariance = here.moments_given(elsewhere * here.marginalise(others))
        dense_mean, dense = (here * elsewhere).moments
        np.testing.assert_allclose(mean, dense_mean, atol=1e-9)
        np.testing.assert_allclose(covariance, dense, atol=1e-9)
    mean, covariance = here.moments_given(Gaussian((), np.zeros((0, 0)), np.zeros(0), None))
    np.testing.assert_allclose(mean, here.moments[0])
    np.testing.assert_allclose(covariance, here.moments[1])


@pytest.mark.mpi
def test_draws_are_of_the_joint_posterior(model: Model, comm: MPI.Comm) -> None:
    gaussian = summed(model, comm).gaussian(model.priors)
    model_mean, covariance = model.posterior()
    posterior = gaussian.solve()
    n = 3000
    drawn = [gaussian.values(posterior.draw(generator(6, "draw", i))) for i in range(n)]
    draws = np.array([np.concatenate([as_real(values) for values in one.values()]) for one in drawn])
    std = np.sqrt(np.diag(covariance))
    assert np.abs((draws.mean(axis=0) - model_mean) / std).max() < 5 / np.sqrt(n)
    white = (draws - model_mean) / std
    np.testing.assert_allclose(white.T @ white / n, covariance / np.outer(std, std), atol=6 / np.sqrt(n))


def test_values_and_vectors_are_the_same_thing(model: Model) -> None:
    gaussian = model.equations(np.arange(N_ROWS)).gaussian(model.priors)
    drawn = gaussian.draw(generator(7, "draw"))
    assert {name: np.iscomplexobj(one) for name, one in drawn.items()} == {b.name: b.is_complex for b in model.blocks}
    again = gaussian.values(gaussian.vector(drawn))
    for name, values in drawn.items():
        np.testing.assert_array_equal(again[name], values)


def test_a_flat_prior_has_no_evidence() -> None:
    model = Model(CASES[0])
    priors: dict[str, Prior] = {**model.priors, "sky": FlatPrior(np.zeros(SIZES["sky"]))}
    gaussian = model.equations(np.arange(N_ROWS)).gaussian(priors)
    assert gaussian.solve().log_evidence is None
    assert gaussian.marginalise(["gains"]).log_scale is None


def test_unknowns_that_nothing_determines_are_refused() -> None:
    model = Model(CASES[2])
    model.values["sky"][:] = 0
    gaussian = model.equations(np.arange(N_ROWS)).gaussian({**model.priors, "sky": FlatPrior(np.zeros(SIZES["sky"]))})
    with pytest.raises(InputError, match="unknowns of sky free"):
        gaussian.marginalise(["sky"])


def test_names_are_checked() -> None:
    model = Model(CASES[0])
    gaussian = model.equations(np.arange(N_ROWS)).gaussian(model.priors)
    with pytest.raises(KeyError, match="no block gain among beam, gains"):
        gaussian.condition({"gain": np.zeros(4)})
    with pytest.raises(ValueError, match="names of their own"):
        NormalEquations([Block("beam", 1), Block("beam", 1)])
