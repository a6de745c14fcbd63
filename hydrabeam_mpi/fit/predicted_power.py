"""How much power the residuals of held-out rows have by what the model is uncertain of, and how much that may scatter.

With the noise of variance one in real and imaginary parts alike, residuals are N(0, 1 + M), with M the covariance of
the predictions: M = A P^-1 A^T + D S D^T, where A are the beam's columns, uncertain by P given the effects, and D those
of the effects, which the beam follows, with the errors S. Half of the sum of their squares, the chi^2 of complex data
over the noise alone, has the mean n + tr(M) / 2 and the variance n + tr(M) + tr(M^2) / 2. What is uncertain of a beam
is the same at all times, so that its part in that may be no more certain than a few squares are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.local_parameters import untold, with_own
from hydrabeam_mpi.fit.marginal import in_parts
from hydrabeam_mpi.fit.predictive_density import of_each_channel, products_that_follow
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.whitening import root_by_shared
from hydrabeam_mpi.inference.posterior import Posterior


def squares_of_model(context: FitContext, fitted: Fitted) -> float | None:
    """Return tr(M^2) of all held-out rows, on rank 0. Collective: all ranks of the grid.

    Parameters of single held-out times or baselines have no part in it: they are fitted to half of these rows.
    """
    channels = of_each_channel(context, fitted, _by_channel)
    if channels is None:
        return None
    values, local = fitted.values, untold(context, fitted.values)
    of_kind = [np.full(one.size, local is not None and one.effect.local == local) for one in values.active]
    unknown = np.concatenate([np.zeros(0, dtype=bool), *of_kind])
    first, rest = np.flatnonzero(values.shared), np.flatnonzero(~values.shared)
    total, of_shared = 0.0, [np.zeros((len(first), len(first)))]
    for channel, covariance in channels:
        known = with_own(covariance, unknown, np.zeros((np.count_nonzero(unknown),) * 2))
        root = root_by_shared(known, values.shared)
        by_errors = root.T @ channel.by_effects @ root
        total += channel.by_beam + 2 * float(np.sum(channel.by_both * known))
        total += float(2 * np.sum(by_errors[np.ix_(first, rest)] ** 2) + np.sum(by_errors[np.ix_(rest, rest)] ** 2))
        of_shared.append(by_errors[np.ix_(first, first)])
    return total + float(np.sum(np.sum(of_shared, axis=0) ** 2))


@dataclass(frozen=True)
class _Channel:
    """Products of a channel's columns.

    Attributes
    ----------
    by_beam : float
        tr((A P^-1 A^T)^2).
    by_both, by_effects : ndarray, (q, q)
        D^T A P^-1 A^T D and D^T D.
    """

    by_beam: float
    by_both: FloatArray
    by_effects: FloatArray


def _by_channel(sums: NormalEquations, beam: Posterior, seen: BoolArray, response: Array) -> _Channel:
    """Work them out. Arguments are those of `predictive_density.of_each_channel`."""
    kappa, factor = 1.0 if beam.is_complex else 2.0, beam.factor
    half = solve_triangular(factor, kappa * sums.own(BEAM), lower=True)
    whole = solve_triangular(factor, half.conj().T, lower=True)
    across, by_effects = products_that_follow(sums, seen, response)
    by_both = in_parts(solve_triangular(factor, across, lower=True))
    return _Channel(2 / kappa * float(np.sum(np.abs(whole) ** 2)), 2 * kappa * by_both.T @ by_both, by_effects)
