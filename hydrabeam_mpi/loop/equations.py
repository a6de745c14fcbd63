"""The additive sums from which effects are judged: those of the columns beside those of the beam.

For columns S, the beam's design A, the residual r and the weights N^-1 of some rows they are

    2 Re S^H N^-1 S,    2 Re S^H N^-1 r,    A^H N^-1 S

which add up over rows, hence over ranks, as the normal equations of the beam do. Redundant baselines share their row of
A, so that A^H N^-1 S needs the columns summed over each group only; the columns themselves may differ within a group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import csr_array, diags_array, issparse

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.base import Columns
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.infer.posterior import Posterior
from hydrabeam_mpi.loop.evidence import Likelihood
from hydrabeam_mpi.mpi import Comm, allreduce_sum

Matrix = Any  # a NumPy array or a SciPy sparse one


@dataclass
class EffectSums:
    """Sums over rows for some columns.

    Attributes
    ----------
    signal : ndarray, (q, q)
        2 Re S^H N^-1 S.
    score : ndarray, (q,)
        2 Re S^H N^-1 r.
    cross : ndarray, (n, q)
        2 Re A^H N^-1 S for real coefficients; sqrt 2 A^H N^-1 S for complex ones. In either case the beam takes
        Re cross^H P^-1 cross off the information, with P the precision of its posterior.
    """

    signal: FloatArray
    score: FloatArray
    cross: NDArray[Any]

    @classmethod
    def zeros(cls, q: int, n_modes: int, is_complex: bool) -> EffectSums:
        """Return empty sums."""
        return cls(np.zeros((q, q)), np.zeros(q), np.zeros((n_modes, q), dtype=complex if is_complex else float))

    def reduce(self, comm: Comm) -> None:
        """Sum over ranks. Collective: all ranks of `comm`."""
        for array in (self.signal, self.score, self.cross):
            allreduce_sum(comm, array)

    def without_beam(self, posterior: Posterior) -> Likelihood:
        """Marginalise the beam (the Schur complement)."""
        half = solve_triangular(posterior.factor, self.cross, lower=True, check_finite=False)
        parts = np.concatenate([half.real, half.imag]) if np.iscomplexobj(half) else half
        taken = parts.T @ parts
        return Likelihood(self.signal - taken, self.score, self.signal)


@dataclass
class Part:
    """Columns of a scene with what they share: their weighted form, by baseline and summed over groups."""

    rows: Matrix | None  # (Ntimes x Nbls, q), for effects by baseline
    by_group: Matrix  # (Ntimes x Ngroups, q): columns by group, or None's stand-in for those by baseline
    weighted: Matrix  # (Ntimes x Ngroups, q): weighted columns summed over each group
    weighted_rows: Matrix | None


class SceneSums:
    """Adds the columns of effects to their sums, for one scene.

    Parameters
    ----------
    scene : Scene
    design : ndarray
        Design rows of the scene's times and groups: (Ntimes, 2, Ngroups, n) real and imaginary parts for real
        coefficients, (Ntimes, Ngroups, n) for complex ones.
    """

    def __init__(self, scene: Scene, design: NDArray[Any]) -> None:
        n_times, n_bls = scene.shape
        n_groups = len(scene.groups)
        self.is_complex = np.iscomplexobj(design)
        n_modes = design.shape[-1]
        self.design: NDArray[Any] = (
            design.reshape(-1, n_modes) if self.is_complex else np.moveaxis(design, 1, 0).reshape(2, -1, n_modes)
        )
        self.weights = scene.weights.reshape(-1)
        self.weighted_residual = (scene.weights * scene.residual).reshape(-1)
        column = (np.arange(n_times)[:, np.newaxis] * n_groups + scene.member).reshape(-1)
        ones = np.ones(n_times * n_bls)
        members = csr_array((ones, (column, np.arange(len(column)))), shape=(n_times * n_groups, len(column)))
        self.members = members
        self.group_weights = members @ self.weights
        self.group_residual = members @ self.weighted_residual

    def part(self, columns: Columns, used: NDArray[Any] | None = None) -> Part:
        """Prepare columns, of which only those ``used`` count."""
        matrix = columns.matrix()
        if used is not None:
            matrix = matrix[:, used]
        if columns.by_group:
            return Part(None, matrix, self.group_weights[:, np.newaxis] * matrix, None)
        weighted = diags_array(self.weights) @ matrix if issparse(matrix) else self.weights[:, np.newaxis] * matrix
        return Part(matrix, None, self.members @ weighted, weighted)

    def score(self, part: Part) -> FloatArray:
        """Return 2 Re S^H N^-1 r."""
        if part.rows is None:
            return np.asarray(2 * (part.by_group.conj().T @ self.group_residual).real)
        return np.asarray(2 * (part.rows.conj().T @ self.weighted_residual).real)

    def cross(self, part: Part) -> NDArray[Any]:
        """Return the products with the design; see `EffectSums.cross`."""
        weighted = part.weighted
        if self.is_complex:
            if issparse(weighted):
                return np.asarray(np.sqrt(2) * (weighted.T @ self.design.conj()).T)
            return np.asarray(np.sqrt(2) * (self.design.conj().T @ weighted))
        real, imag = self.design
        if issparse(weighted):
            return np.asarray(2 * (weighted.real.T @ real + weighted.imag.T @ imag).T)
        return np.asarray(2 * (real.T @ weighted.real + imag.T @ weighted.imag))

    def signal(self, one: Part, two: Part) -> FloatArray:
        """Return 2 Re S1^H N^-1 S2."""
        if one.rows is None:
            product = one.by_group.conj().T @ two.weighted
        elif two.rows is None:
            product = one.weighted.conj().T @ two.by_group
        else:
            product = one.rows.conj().T @ two.weighted_rows
        return np.asarray(2 * (product.toarray() if issparse(product) else product).real)


@dataclass
class JointSums:
    """Sums for the effects that are part of the model (``active``) and for candidates, one by one.

    Attributes
    ----------
    active : EffectSums
        Of all active effects side by side.
    candidates : list of EffectSums
    across : list of ndarray, (q_active, q)
        2 Re S_active^H N^-1 S of each candidate.
    """

    active: EffectSums
    candidates: list[EffectSums]
    across: list[FloatArray]

    @classmethod
    def zeros(cls, q_active: int, q: Sequence[int], n_modes: int, is_complex: bool) -> JointSums:
        """Return empty sums."""
        return cls(
            EffectSums.zeros(q_active, n_modes, is_complex),
            [EffectSums.zeros(size, n_modes, is_complex) for size in q],
            [np.zeros((q_active, size)) for size in q],
        )

    def add(self, sums: SceneSums, active: Sequence[Part], candidate: int | None, part: Part | None) -> None:
        """Add a scene's columns of the active effects, or (with their parts made before) of one candidate."""
        edges = np.cumsum([0, *(_width(one) for one in active)])
        spans = [slice(lo, hi) for lo, hi in pairwise(edges.tolist())]
        if candidate is None or part is None:
            for one, span in zip(active, spans, strict=True):
                self.active.score[span] += sums.score(one)
                self.active.cross[:, span] += sums.cross(one)
                for two, other in zip(active, spans, strict=True):
                    self.active.signal[span, other] += sums.signal(one, two)
            return
        target = self.candidates[candidate]
        target.score += sums.score(part)
        target.cross += sums.cross(part)
        target.signal += sums.signal(part, part)
        for one, span in zip(active, spans, strict=True):
            self.across[candidate][span] += sums.signal(one, part)

    def reduce(self, comm: Comm) -> None:
        """Sum over ranks. Collective: all ranks of `comm`."""
        for one in (self.active, *self.candidates):
            one.reduce(comm)
        for array in self.across:
            allreduce_sum(comm, array)

    def candidate(self, number: int, posterior: Posterior) -> Likelihood:
        """Return the joint likelihood of the active effects and one candidate with the beam marginalised.

        Parameters
        ----------
        number : int
        posterior : Posterior
            Of the beam, given the active effects.
        """
        one, across = self.candidates[number], self.across[number]
        both = EffectSums(
            np.block([[self.active.signal, across], [across.T, one.signal]]),
            np.concatenate([self.active.score, one.score]),
            np.concatenate([self.active.cross, one.cross], axis=1),
        )
        return both.without_beam(posterior)


def _width(part: Part) -> int:
    matrix = part.by_group if part.rows is None else part.rows
    return int(matrix.shape[1])


def beam_change(posterior: Posterior, cross: NDArray[Any]) -> NDArray[Any]:
    """Return by how much the beam's coefficients move with each parameter of ``cross``, (n_modes, q)."""
    half = solve_triangular(posterior.factor, cross, lower=True, check_finite=False)
    moved = solve_triangular(posterior.factor, half, lower=True, trans="C", check_finite=False)
    return np.asarray(-moved / (np.sqrt(2) if posterior.is_complex else 1.0))
