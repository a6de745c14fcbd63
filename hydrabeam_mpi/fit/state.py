"""What is in the model beside the beams, what a fit of it gives, and how well it fits: values that do not change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray, IntArray
from hydrabeam_mpi.data.partition import spans
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.blocks import effect_columns
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import ChannelPrior, DiagonalPrior, precision_of


@dataclass(frozen=True)
class Active:
    """An effect that is part of the model; a `ModelBlock`.

    Attributes
    ----------
    effect : Effect
    used : ndarray of int, (n_used,)
        Which of its parameters are not held at zero.
    prior : ChannelPrior
        Of those in use.
    x : ndarray, (Nfreqs, n_params)
        Of all the job's channels; shared parameters are repeated.
    step_limit : ndarray, (n_params,)
        Largest step of one Gauss-Newton iteration.
    degenerate_directions : ndarray, (n, n_params)
        Combinations of parameters that are held at zero.
    """

    effect: Effect
    used: IntArray
    prior: ChannelPrior
    x: FloatArray
    step_limit: FloatArray
    degenerate_directions: FloatArray

    @classmethod
    def start(cls, effect: Effect, setup: ObservingSetup, prior_var: FloatArray, x: FloatArray) -> Active:
        """Begin with ``x``, (Nblocks, n_params); elements in use bring their `nonlinear` parameters with them.

        Parameters of variance ``prior_var``, (n_params,), zero are not in use; the prior of nonlinear ones has three
        times their natural size.
        """
        parameters = effect.parameters(setup)
        nonlinear = parameters.nonlinear & np.isin(parameters.element, parameters.element[prior_var > 0])
        n_freqs = setup.observation.Nfreqs
        held = effect.degenerate_directions(setup)
        free = np.all((prior_var > 0) | (held == 0), axis=1)
        held = held[free]
        x = x - (x @ np.linalg.pinv(held)) @ held
        prior_var = np.where(nonlinear, (3 * parameters.scale) ** 2, prior_var)
        return cls(
            effect,
            *independent_prior(prior_var, effect.shared),
            np.broadcast_to(x, (n_freqs, len(parameters))).copy(),
            np.where(parameters.nonlinear, parameters.scale, np.inf),
            held,
        )

    is_complex = False

    @property
    def kind(self) -> str:
        """The effect's name."""
        return self.effect.kind

    @property
    def size(self) -> int:
        """Number of parameters in use."""
        return len(self.used)

    @property
    def effects(self) -> Sequence[Effect]:
        """The effect."""
        return (self.effect,)

    @property
    def held(self) -> FloatArray:
        """Combinations of the parameters in use that are held at zero, (n, n_used)."""
        return self.degenerate_directions[:, self.used]

    def prior_var(self, setup: ObservingSetup) -> FloatArray:
        """Return the variances of the prior, (n_params,), zero for what is not in use and for what is nonlinear."""
        prior_var: FloatArray = np.zeros(self.x.shape[1])
        prior_var[self.used] = self.prior.of(0).std() ** 2
        prior_var[self.effect.parameters(setup).nonlinear] = 0.0
        return prior_var

    def without_turns(self, setup: ObservingSetup) -> Active:
        """Return the effect with the values nearest to zero that are the same C, what is held at zero included."""
        x = self.effect.without_turns(setup, self.x)
        if np.array_equal(x, self.x):
            return self
        held = self.degenerate_directions
        return replace(self, x=x - (x @ np.linalg.pinv(held)) @ held)

    def labels(self, setup: ObservingSetup) -> list[tuple[str, str]]:
        """Return name and unit of each parameter in use."""
        parameters = self.effect.parameters(setup)
        return [(parameters.names[i], parameters.units[i]) for i in self.used]

    def columns(self, rows: RowSet, block: RowBlock) -> Columns:
        """Return the columns of the parameters in use."""
        return effect_columns(rows, block.columns_of(self.effect, self.x[block.channel]), self.used)

    @property
    def adds(self) -> bool:
        """Whether it gives an E, visibilities that are added to those of the beam, or a C, that may depend on it."""
        return (not self.effect.multiplies or self.effect.sees_beam) and not self.effect.changes_sky


@dataclass(frozen=True)
class Reweighted:
    """A change of the weights that is part of the model, parameters (Nfreqs, n_params)."""

    change: Any
    x: FloatArray
    std: FloatArray


@dataclass(frozen=True)
class Values:
    """What is part of the model beside the beams: all channels, the same on all ranks.

    Attributes
    ----------
    active : tuple of Active
    reweighted : tuple of Reweighted
    prior_widths : PriorWidths, optional
        Of the beams' prior, where they are not those that the job states.
    """

    active: tuple[Active, ...] = ()
    reweighted: tuple[Reweighted, ...] = ()
    prior_widths: PriorWidths | None = None

    def extended(self, active: Active) -> Values:
        """Return these and one more effect."""
        return replace(self, active=(*self.active, active))

    def without(self, place: int) -> Values:
        """Return these but for the effect at a place."""
        return replace(self, active=(*self.active[:place], *self.active[place + 1 :]))

    @property
    def adds(self) -> bool:
        """Whether there is an E, or a C, that may depend on the beams."""
        return any(one.adds for one in self.active)

    @cached_property
    def blocks(self) -> dict[str, Active]:
        """The effects by names of their own."""
        return {f"{number} {one.kind}": one for number, one in enumerate(self.active)}

    @property
    def spans(self) -> tuple[slice, ...]:
        """Where each effect's parameters in use are, when those of all are side by side."""
        return tuple(spans(one.size for one in self.active))

    @property
    def shared(self) -> BoolArray:
        """Whether channels share each of the active parameters in use, side by side, (q,)."""
        return np.concatenate([np.zeros(0, dtype=bool), *(np.full(one.size, one.prior.shared) for one in self.active)])

    def prior_std(self, channel: int) -> FloatArray:
        """Return the prior's standard deviations in a channel, of the parameters in use side by side, (q,)."""
        return np.concatenate([np.zeros(0), *(one.prior.of(channel).std() for one in self.active)])

    def prior_precision(self, channel: int) -> FloatArray:
        """Return the precision of the prior of a channel's parameters in use, side by side, (q, q)."""
        return np.asarray(block_diag(np.zeros((0, 0)), *(precision_of(one.prior.of(channel)) for one in self.active)))

    def prior_score(self, channel: int) -> FloatArray:
        """Return the gradient of the logarithm of the prior in a channel's parameters in use, (q,)."""
        return np.concatenate([np.zeros(0), *(one.prior.score(one.x[:, one.used])[channel] for one in self.active)])

    @property
    def x(self) -> FloatArray:
        """The active parameters in use, side by side, (Nfreqs, q); there must be an effect."""
        return np.concatenate([one.x[:, one.used] for one in self.active], axis=1)

    def without_turns(self, setup: ObservingSetup) -> Values:
        """Return the same model without whole turns of phases, which the data do not know, but the prior does."""
        active = tuple(one.without_turns(setup) for one in self.active)
        is_so = all(one is other for one, other in zip(active, self.active, strict=True))
        return self if is_so else replace(self, active=active)

    def at(self, x: FloatArray) -> Values:
        """Return the same effects with other values of the parameters in use, side by side, (Nfreqs, q)."""
        moved = []
        for one, span in zip(self.active, self.spans, strict=True):
            values = one.x.copy()
            values[:, one.used] = x[:, span]
            moved.append(replace(one, x=values))
        return replace(self, active=tuple(moved))

    def by_effect(self, in_use: FloatArray) -> tuple[FloatArray, ...]:
        """Give what is known of the parameters in use, (Nfreqs, q), to each effect's, zero where not in use."""
        parts = [np.zeros_like(one.x) for one in self.active]
        for part, one, span in zip(parts, self.active, self.spans, strict=True):
            part[:, one.used] = in_use[:, span]
        return tuple(parts)


@dataclass(frozen=True)
class Estimate:
    """Values and the beams that go with them: what the model's visibilities are made of.

    Attributes
    ----------
    values : Values
    beams : tuple of Posterior
        Of this rank group's channels, given the values; empty before the first is solved for.
    """

    values: Values
    beams: tuple[Posterior, ...] = ()

    def towards(self, other: Estimate, length: float) -> Estimate:
        """Return what is part of the way to another estimate, with the uncertainty of that one's beams."""
        if length == 1.0:
            return other
        pairs = zip(self.values.active, other.values.active, strict=True)
        active = tuple(replace(two, x=one.x + length * (two.x - one.x)) for one, two in pairs)
        beams = tuple(
            replace(two, mean=one.mean + length * (two.mean - one.mean))
            for one, two in zip(self.beams, other.beams, strict=True)
        )
        return Estimate(replace(other.values, active=active), beams)


@dataclass(frozen=True)
class Fit:
    """What a fit gives: of this rank group's channels, others that they hang together with marginalised, and all std.

    Attributes
    ----------
    posteriors : tuple of Posterior
        Of the beams, given the channel's effects.
    covariances : tuple of ndarray, (q, q)
        Posterior covariance of all active parameters in use, side by side.
    beam_response : tuple of ndarray, (n_modes, q)
        By how much the beam's coefficients move when one of these parameters does.
    std : tuple of ndarray, (Nfreqs, n_params)
        Posterior standard deviations of each active effect's parameters, of all the job's channels.
    """

    posteriors: tuple[Posterior, ...] = ()
    covariances: tuple[FloatArray, ...] = ()
    beam_response: tuple[Array, ...] = ()
    std: tuple[FloatArray, ...] = ()

    def with_beams(self, beams: tuple[Posterior, ...]) -> Fit:
        """Return the same of other beams; where their uncertainty is known already their means alone count."""
        known = tuple(replace(one, mean=beam.mean) for one, beam in zip(self.posteriors, beams, strict=False))
        return replace(self, posteriors=known or beams)


class Ended(Enum):
    """Why a fit ended.

    Nothing moves any more; no part of a step leads higher, and none was expected to by as much as evidence tells, or by
    more than that; or it had taken all its steps.
    """

    CONVERGED = "converged"
    FLAT = "flat"
    STUCK = "stuck"
    OUT_OF_STEPS = "out of steps"


@dataclass(frozen=True)
class Diagnostics:
    """How well the fitted rows are fitted, for each of this rank group's channels.

    Attributes
    ----------
    train_chi2 : ndarray, (Nlocal,)
        Reduced chi^2 of the fitted rows.
    log_joint : ndarray, (Nlocal,)
        Logarithm of the likelihood of the fitted rows times the prior of the beam at its mean, up to a constant.
    effective_parameters : ndarray, (Nlocal,)
        How many real parameters of the beam the fitted rows have decided, tr(P^-1 F^H N^-1 F); on group roots.
    n_data : ndarray, (Nlocal,)
        Number of complex data that were fitted; on group roots.
    ended : Ended
    """

    train_chi2: FloatArray = field(default_factory=lambda: np.zeros(0))
    log_joint: FloatArray = field(default_factory=lambda: np.zeros(0))
    effective_parameters: FloatArray = field(default_factory=lambda: np.zeros(0))
    n_data: FloatArray = field(default_factory=lambda: np.zeros(0))
    ended: Ended = Ended.CONVERGED

    @property
    def converged(self) -> bool:
        """Whether the fit ended where nothing moves any more, or by no more than evidence tells."""
        return self.ended in (Ended.CONVERGED, Ended.FLAT)


@dataclass(frozen=True)
class Fitted:
    """Values where the model has been fitted, what the fit gave, and how well it fits."""

    values: Values = Values()
    fit: Fit = Fit()
    diagnostics: Diagnostics = Diagnostics()

    @property
    def estimate(self) -> Estimate:
        """The fitted values and beams."""
        return Estimate(self.values, self.fit.posteriors)


def independent_prior(prior_var: FloatArray, shared: bool) -> tuple[IntArray, ChannelPrior]:
    """Return which parameters are in use, those of ``prior_var``, (n_params,), not zero, and their prior about zero.

    The indices are (n_used,).
    """
    used = np.flatnonzero(prior_var)
    return used, ChannelPrior((DiagonalPrior(np.zeros(len(used)), np.sqrt(prior_var[used])),), shared)
