"""How wide the prior is of what the beams of all channels have in common, by the evidence as in `widths_evidence`.

Given the prior of what each channel has of its own, all channels together tell of the common coefficients c what one
channel tells of its beam's: their information J and pull g, with the channels' own parts and all effects marginalised.
Both follow from the posterior of c, whose precision is J + S^-1, S being the prior's covariance now.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Active, Fitted, Values, independent_prior
from hydrabeam_mpi.fit.widths_evidence import WidthsEvidence
from hydrabeam_mpi.inference.matrices import cholesky_lower, inverse_of_covariance
from hydrabeam_mpi.inference.mode_widths import ModeSizes
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import DiagonalPrior
from hydrabeam_mpi.mpi import together


def with_common_widths(context: FitContext, fitted: Fitted) -> Values | None:
    """Return the values with the prior of the common part that has the most evidence; None if it has that already.

    None where there is no common part, too. Collective: all ranks of the grid.
    """
    place = next((place for place, one in enumerate(fitted.values.active) if not one.effect.is_sought), None)
    if place is None:
        return None
    evidence = _CommonWidths(context, fitted, place)
    found = evidence.best()
    if found.widths is None or found.gain < context.problem.job.loop.min_log_bayes_factor:
        return None
    one, std = fitted.values.active[place], np.hypot(*evidence.sizes.widths(found.widths))
    is_complex = context.setup.basis.is_complex
    prior_var: FloatArray = np.zeros(one.x.shape[1])
    prior_var[one.used] = np.tile(std**2 / 2, 2) if is_complex else std**2
    used, prior = independent_prior(prior_var, one.effect.shared)
    active = list(fitted.values.active)
    active[place] = replace(one, used=used, prior=prior)
    return replace(fitted.values, active=tuple(active))


class _CommonWidths(WidthsEvidence):
    """What a fit tells of the widths of the common part's prior."""

    def __init__(self, context: FitContext, fitted: Fitted, place: int) -> None:
        self._place, self._value_now = place, 0.0
        self.sizes: ModeSizes
        super().__init__(context, replace(fitted, values=replace(fitted.values, prior_widths=None)))

    def _take(self, context: FitContext, fitted: Fitted) -> None:
        grid = context.grid
        mine = [prior.sizes for prior in context.problem.priors if isinstance(prior, DiagonalPrior)]
        every = [one for part in grid.world.allgather(mine if grid.is_group_root else []) for one in part]
        one, is_complex = fitted.values.active[self._place], context.setup.basis.is_complex
        which = one.used[: one.size // 2] if is_complex else one.used
        with together(grid.world):
            rms = np.sqrt(np.mean([sizes.amplitudes**2 for sizes in every], axis=0))
            largest = float(np.sqrt(np.mean([sizes.largest**2 for sizes in every])))
            self.sizes = ModeSizes(rms[which], every[0].orders[which], largest)
            if grid.is_world_root:
                precision, mean, std = _posterior_of(fitted, self._place, is_complex)
                own = precision - np.diag(std**-2.0)
                beam = Posterior(mean, cholesky_lower(precision))
                self._add(own, beam, DiagonalPrior(np.zeros_like(mean), std, self.sizes))
                self._value_now = self._channels[0].log_evidence(std)
        self._value_now = float(grid.world.bcast(self._value_now))

    def _here(self, channels: object) -> float:
        """Return ln evidence with the prior of the fit, whatever its widths follow from."""
        return self._value_now


def _posterior_of(fitted: Fitted, place: int, is_complex: bool) -> tuple[Array, Array, FloatArray]:
    """Return precision, (m, m), and mean, (m,), of the common coefficients in use, and their prior's std, (m,).

    Of complex ones the parameters are real parts, then imaginary ones: the precision of c is half of that of both.
    """
    active = fitted.values.active
    start = sum(one.size for one in active[:place])
    one: Active = active[place]
    own = slice(start, start + one.size)
    precision = inverse_of_covariance(fitted.fit.covariances[0][own, own])
    x, std = one.x[0, one.used], one.prior.of(0).std()
    if not is_complex:
        return precision, x, std
    m = one.size // 2
    real = precision[:m, :m] + precision[m:, m:]
    imaginary = precision[m:, :m] - precision[:m, m:]
    return 0.25 * (real + 1j * imaginary), x[:m] + 1j * x[m:], np.sqrt(2) * std[:m]
