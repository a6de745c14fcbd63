"""Gaussian functions of several blocks of unknowns, such as a beam's coefficients and the gains of antennas.

In information form a Gaussian is known by its precision P and its source h,

    ln f(x) = log_scale + (2 Re x^H h - x^H P x) / kappa,

with kappa = 1 for complex unknowns, whose normal density is exp(-x^H P x), and kappa = 2 for real ones, whose density
is exp(-x^T P x / 2). Its maximum is at P^-1 h. Some unknowns can be set to values (`condition`), or integrated over
(`marginalise`); either gives another Gaussian (HDBI II, eqs 11-14, are those of a single block).

Where real and complex blocks meet, a complex one of n unknowns is kept as 2 n real ones, real parts before imaginary
ones: a complex unknown that real ones are marginalised from has no circular density any more.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.matrices import cholesky_lower, inverse_hermitian
from hydrabeam_mpi.inference.posterior import Posterior


@dataclass(frozen=True)
class Block:
    """Unknowns that belong together.

    Attributes
    ----------
    name : str
    size : int
        Number of unknowns.
    is_complex : bool
    """

    name: str
    size: int
    is_complex: bool = False


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian function of the unknowns of some blocks, not normalised.

    Attributes
    ----------
    blocks : tuple of Block
        In the order of the matrix.
    precision : ndarray, (n, n)
        P. Complex where all blocks are; else real, with complex blocks in real and imaginary parts.
    source : ndarray, (n,)
        h.
    log_scale : float or None
        ln f(0); None where a flat prior leaves it open.
    """

    blocks: tuple[Block, ...]
    precision: Array
    source: Array
    log_scale: float | None

    @property
    def is_complex(self) -> bool:
        """Whether the matrix is complex, as all blocks are."""
        return bool(np.iscomplexobj(self.precision))

    @property
    def kappa(self) -> float:
        """1 for a complex matrix, 2 for a real one."""
        return 1.0 if self.is_complex else 2.0

    @property
    def spans(self) -> dict[str, slice]:
        """Rows of the matrix that belong to each block."""
        return spans_of(self.blocks, in_parts=not self.is_complex)

    def vector(self, values: Mapping[str, Array]) -> Array:
        """Put the values of all blocks side by side as the matrix has them, (n,)."""
        parts = [_as_rows(np.asarray(values[one.name]), one, in_parts=not self.is_complex) for one in self.blocks]
        return np.concatenate([self.source[:0], *parts])

    def values(self, vector: Array) -> dict[str, Array]:
        """Take each block's values out of a vector in the order of the matrix, (..., n)."""
        found = {}
        for one in self.blocks:
            part = vector[..., self.spans[one.name]]
            in_parts = one.is_complex and not self.is_complex
            found[one.name] = part[..., : one.size] + 1j * part[..., one.size :] if in_parts else part
        return found

    def condition(self, on: Mapping[str, Array]) -> Gaussian:
        """Return the function of the other blocks that is left where some have known values.

        Parameters
        ----------
        on : mapping of str to ndarray, (size,)
            Values of the blocks that are known.
        """
        known, rest, blocks = self._split(on)
        parts = [
            _as_rows(np.asarray(on[one.name]), one, in_parts=not self.is_complex)
            for one in self.blocks
            if one.name in on
        ]
        x = np.concatenate([self.source[:0], *parts])
        source = self.source[rest] - self.precision[np.ix_(rest, known)] @ x
        log_scale = self.log_scale
        if log_scale is not None:
            own = self.precision[np.ix_(known, known)]
            log_scale += float(2 * np.vdot(x, self.source[known]).real - np.vdot(x, own @ x).real) / self.kappa
        return Gaussian(blocks, self.precision[np.ix_(rest, rest)], source, log_scale)

    def marginalise(self, out: Collection[str]) -> Gaussian:
        """Return the function of the other blocks that is left when some are integrated over (Schur complement).

        Parameters
        ----------
        out : collection of str
            Names of the blocks to integrate over.

        Raises
        ------
        InputError
            If nothing determines their unknowns.
        """
        if not out:
            return self
        gone, rest, blocks = self._split(out)
        own, unit = in_units(self.precision[np.ix_(gone, gone)])
        pulled = unit[:, np.newaxis] * np.column_stack([self.precision[np.ix_(gone, rest)], self.source[gone]])
        try:
            taken, log_det = _seen_through(own, pulled)
        except LinAlgError as error:
            names = ", ".join(out)
            raise InputError(
                f"data and prior leave some of the unknowns of {names} free", remedy="use a prior that is not flat"
            ) from error
        log_scale = self.log_scale
        if log_scale is not None:
            log_det -= 2 * float(np.sum(np.log(unit)))
            log_scale += _log_volume(len(gone), log_det, float(taken[-1, -1].real), self.kappa)
        precision = self.precision[np.ix_(rest, rest)] - taken[:-1, :-1]
        source = self.source[rest] - taken[:-1, -1]
        return Gaussian(blocks, 0.5 * (precision + precision.conj().T), source, log_scale)

    def __mul__(self, other: Gaussian) -> Gaussian:
        """Return the product with another, of the unknowns of either: blocks of the same name are the same.

        Both or neither are complex.
        """
        blocks = (*self.blocks, *(one for one in other.blocks if one not in self.blocks))
        spans = spans_of(blocks, in_parts=not (self.is_complex or other.is_complex))
        n = max((span.stop for span in spans.values()), default=0)
        dtype = np.result_type(self.precision, other.precision)
        precision, source = np.zeros((n, n), dtype), np.zeros(n, dtype)
        for factor in (self, other):
            rows = _rows_of(spans, [one.name for one in factor.blocks])
            precision[np.ix_(rows, rows)] += factor.precision
            source[rows] += factor.source
        scales = [factor.log_scale for factor in (self, other) if factor.log_scale is not None]
        return Gaussian(blocks, precision, source, sum(scales) if len(scales) == 2 else None)

    @cached_property
    def moments(self) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n), also where rounding has left the precision not quite positive."""
        matrix, unit = in_units(self.precision)
        covariance = unit[:, np.newaxis] * inverse_hermitian(matrix) * unit
        return covariance @ self.source, covariance

    def moments_given(self, others: Gaussian) -> tuple[Array, Array]:
        """Return mean (n,) and covariance (n, n) where all that is known of some blocks has come together elsewhere.

        Parameters
        ----------
        others : Gaussian
            Of these blocks, what this one says of them included; it may be of more blocks.
        """
        center, spread = others.moments
        names = [name for name in self.spans if name in others.spans]
        given, own = self.condition({name: others.values(center)[name] for name in names}).moments
        known, rest, _ = self._split(names)
        there = _rows_of(others.spans, names)
        spread, response = spread[np.ix_(there, there)], -own @ self.precision[np.ix_(rest, known)]
        mean, covariance = np.zeros_like(self.source), np.zeros_like(self.precision)
        mean[known], mean[rest] = center[there], given
        covariance[np.ix_(known, known)] = spread
        covariance[np.ix_(rest, known)] = response @ spread
        covariance[np.ix_(known, rest)] = covariance[np.ix_(rest, known)].conj().T
        covariance[np.ix_(rest, rest)] = own + response @ spread @ response.conj().T
        return mean, covariance

    def solve(self, overwrite: bool = False, factor: Array | None = None) -> Posterior:
        """Return the normalised Gaussian, with ln of the integral of f as its evidence.

        Parameters
        ----------
        overwrite : bool
            Whether the memory of the precision may be used for its factor; this object is of no use then.
        factor : ndarray, (n, n), optional
            Lower L with L L^H the precision, where it is known already.

        Raises
        ------
        InputError
            If some combination of the unknowns is not determined.
        """
        if factor is None:
            factor = cholesky_lower(self.precision if overwrite else self.precision.copy())
        half = solve_triangular(factor, self.source, lower=True, check_finite=False)
        mean = solve_triangular(factor, half, lower=True, trans="C", check_finite=False)
        log_evidence = None
        if self.log_scale is not None:
            log_det = 2 * float(np.sum(np.log(np.diag(factor).real)))
            log_evidence = self.log_scale + _log_volume(len(mean), log_det, float(np.vdot(half, half).real), self.kappa)
        return Posterior(mean, factor, log_evidence)

    def draw(self, rng: np.random.Generator) -> dict[str, Array]:
        """Draw values of all blocks from the normalised Gaussian, each (size,)."""
        return self.values(self.solve().draw(rng))

    def log_evidence(self) -> float | None:
        """Return ln of the integral of f over all unknowns; None where a flat prior leaves it open."""
        return self.marginalise([one.name for one in self.blocks]).log_scale

    def _split(self, names: Collection[str]) -> tuple[Array, Array, tuple[Block, ...]]:
        """Return the rows of some blocks, those of the others, and the others."""
        unknown = set(names) - {one.name for one in self.blocks}
        if unknown:
            raise KeyError(f"no block {', '.join(sorted(unknown))} among {', '.join(self.spans)}")
        chosen = _rows_of(self.spans, [name for name in self.spans if name in names])
        return (
            chosen,
            np.delete(np.arange(len(self.source)), chosen),
            tuple(one for one in self.blocks if one.name not in names),
        )


def spans_of(blocks: Sequence[Block], in_parts: bool) -> dict[str, slice]:
    """Return where each block lies when they are side by side; ``in_parts`` gives complex ones twice the room."""
    spans, start = {}, 0
    for one in blocks:
        width = one.size * (2 if one.is_complex and in_parts else 1)
        spans[one.name] = slice(start, start + width)
        start += width
    return spans


def _rows_of(spans: Mapping[str, slice], names: Sequence[str]) -> IntArray:
    """Return the rows of some blocks, one after the other."""
    return np.concatenate([np.zeros(0, dtype=int), *(np.arange(spans[name].start, spans[name].stop) for name in names)])


def _seen_through(precision: Array, columns: Array) -> tuple[Array, float]:
    """Return columns^H P^-1 columns, (k, k), and ln|P|; arguments and what is raised are those of `halves`."""
    left, right, log_det = halves(precision, columns)
    return left.conj().T @ right, log_det


def halves(precision: Array, columns: Array) -> tuple[Array, Array, float]:
    """Return two factors, (n, k), with left^H right = columns^H P^-1 columns, and ln|P| of a Hermitian P, (n, n).

    They are the same, P^-1/2 columns, but where directions of P are determined by no more than rounding errors of
    either sign: these are no obstacle to LU, and it takes twice as long.

    Raises
    ------
    LinAlgError
        If P is singular.
    """
    try:
        factor = cholesky(precision, lower=True, check_finite=False)
    except LinAlgError:
        return columns, np.linalg.solve(precision, columns), float(np.linalg.slogdet(precision)[1])
    half = solve_triangular(factor, columns, lower=True, check_finite=False)
    return half, half, 2 * float(np.sum(np.log(np.diag(factor).real)))


def in_units(precision: Array) -> tuple[Array, FloatArray]:
    """Return a precision in units in which its diagonal is one, (n, n), and these, (n,)."""
    own = np.diag(precision).real
    unit = 1 / np.sqrt(np.where(own > 0, own, 1.0))
    return unit[:, np.newaxis] * precision * unit, unit


def _as_rows(values: Array, block: Block, in_parts: bool) -> Array:
    """Write a complex block's values in parts where the matrix has them so."""
    if block.is_complex and in_parts:
        return np.concatenate([np.real(values), np.imag(values)])
    return values


def _log_volume(n: int, log_det: float, quadratic: float, kappa: float) -> float:
    """Return ln of the integral of exp((2 Re x^H h - x^H P x) / kappa) over n unknowns; h^H P^-1 h is ``quadratic``."""
    return (n * np.log(kappa * np.pi) - log_det + quadratic) / kappa
