"""What stays as it is while a chain walks, and what it asks of the data where it is.

The target is the joint posterior of beams b, effects x, and scales s of the noise's variance and t of the prior's,

    p(b, x, s, t | d)  ~  p(d | b, x, s) p(b | t, x) p(x) p(s) p(t),        d = C (A b + E) + n.

Given the rest it is a Gaussian in b, unless E or C is seen by the beam. Everything is then written by the same with E
and C seen by a fixed beam, that of the fit: a Gaussian in b, whose integral over b is known, and the exact density over
it, which is one where the beam makes no difference to E and C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray, IntArray
from hydrabeam_mpi.fit.beams_given import sum_for_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.known_precision import KnownPrecision
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Estimate, Values
from hydrabeam_mpi.inference.nonnegative import NonNegative
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import DiagonalPrior, Prior
from hydrabeam_mpi.mpi import allreduce_sum, bcast_array, together
from hydrabeam_mpi.sampling.beams_given import BeamsGiven, solve_given
from hydrabeam_mpi.sampling.coupled import draw_together
from hydrabeam_mpi.sampling.latest import Latest
from hydrabeam_mpi.sampling.noise import InverseGamma, NoiseParts, drawn_weights, log_densities, squared_residuals
from hydrabeam_mpi.sampling.proposal import Proposal
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.unknowns import Unknowns


@dataclass(frozen=True)
class Walk:
    """What stays as it is while a chain walks.

    Attributes
    ----------
    context : FitContext
        Of the chain's ranks.
    unknowns : Unknowns
    proposal : Proposal
    seen_by : tuple of Posterior
        The fit's beams.
    noise : InverseGamma, optional
        Where the noise's scale is drawn.
    widths : InverseGamma, optional
        Where those of the prior are.
    group_of : ndarray of int, (n_modes,)
        Group of modes that have a width in common.
    collapsed : bool
        Whether effects are proposed with the beam integrated out, or given the beam.
    parts : NoiseParts, optional
        Where scales of the noise are drawn that are not those of all data.
    dof : float, optional
        Degrees of freedom of noise of Student's t.
    beam_is_seen : bool
        Whether E or C depends on the beams.
    spreads : InverseGamma, optional
        Where widths of the effects' priors are drawn.
    positive : NonNegative, optional
        What makes a beam nowhere negative, where beams are to be so.
    """

    context: FitContext
    unknowns: Unknowns
    proposal: Proposal
    seen_by: tuple[Posterior, ...]
    noise: InverseGamma | None = None
    widths: InverseGamma | None = None
    group_of: IntArray = field(default_factory=lambda: np.zeros(0, dtype=int))
    collapsed: bool = True
    parts: NoiseParts | None = None
    dof: float | None = None
    beam_is_seen: bool = True
    spreads: InverseGamma | None = None
    positive: NonNegative | None = None
    _sums: Latest = field(default_factory=Latest)
    _given: Latest = field(default_factory=Latest)
    _misfits: Latest = field(default_factory=Latest)

    @property
    def channels(self) -> list[int]:
        """Numbers of the rank group's channels."""
        return self.context.channels

    @property
    def hangs_together(self) -> bool:
        """Whether the beams of different channels depend on each other."""
        return self.context.problem.coupling is not None

    def weighed(self, state: ChainState, chance: Chance) -> Walk:
        """Return the walk with weights as the scales of parts of the noise have them, and those of Student's t drawn.

        These are drawn given all else and not kept, so that what is to be known of a state does not grow with the data.
        """
        if self.parts is None and self.dof is None:
            return self
        context, share = self.context, self.context.train
        with together(context.grid.world):
            factor = np.broadcast_to(1 / self.scale_of(share, state), share.rows.data.shape)
            if self.dof is not None:
                squares, _ = self.squares(share, state)
                n_bls = context.setup.observation.Nbls
                factor = factor * drawn_weights(squares, self.dof, chance, self.channels, share.rows.tile, n_bls)
        context = replace(context, train=share.weighed(factor))
        return replace(self, context=context, _sums=Latest(), _given=Latest(), _misfits=Latest())

    def scale_of(self, share: RankData, state: ChainState) -> FloatArray:
        """Return what a state's parts of the noise multiply its variances by, (Nlocal, 1, Nbls or 1)."""
        if self.parts is None:
            return np.ones((len(self.channels), 1, 1))
        return self.parts.scale(state.parts)[:, np.newaxis, share.rows.tile.bls]

    def squares(self, share: RankData, state: ChainState) -> tuple[FloatArray, FloatArray]:
        """Return |r|^2 / sigma^2 of a rank's rows and 1 / sigma^2 of the data as read, by a state's scales.

        (Nlocal, Ntimes, Nbls) each. Of the walk before it was `weighed`. Serial.
        """
        told = squared_residuals(share, Estimate(state.values, self.as_posteriors(state.beams)))
        factor = 1 / (state.noise[:, np.newaxis, np.newaxis] * self.scale_of(share, state))
        return told[0] * factor, told[1] * factor

    def sums(self, values: Values) -> list[NormalEquations]:
        """Return the sums over rows that tell the beams, E and C seen by the fit's. Collective: the chain's ranks."""

        def make() -> list[NormalEquations]:
            found = sum_for_beams(self.context, Estimate(values, self.seen_by))
            if found.known is None:
                self.context.train.known.keep(KnownPrecision.of(found.key, found.normals, None))
            return found.normals

        return self._sums.of(_key(values), make)

    def priors(self, state: ChainState) -> list[Prior]:
        """Return the prior of each channel's beam given the effects and the scales of its variances."""
        priors: Sequence[Prior] = self.context.given(state.values).priors
        if self.widths is None:
            return list(priors)
        return [_widened(one, wider[self.group_of]) for one, wider in zip(priors, state.widths, strict=True)]

    def beams_given(self, state: ChainState) -> BeamsGiven:
        """Solve for the beams given all else. Collective: the chain's ranks.

        Raises
        ------
        InputError
            On all ranks, if the effects leave some beam undetermined.
        """
        return self._given.of(self._key_of(state), lambda: self._solve(state))

    def _key_of(self, state: ChainState) -> bytes:
        noise = state.noise.tobytes()
        if self.hangs_together:
            # All groups solve together, or none does.
            noise = b"".join(self.context.grid.world.allgather(noise))
        return _key(state.values) + noise + state.widths.tobytes()

    def _solve(self, state: ChainState) -> BeamsGiven:
        return solve_given(self.context, self.sums(state.values), state.noise, self.priors(state))

    def mixed(self, taken: BoolArray, new: ChainState, old: ChainState, after: ChainState) -> None:
        """Keep what is known where some of the rank group's channels have gone and others have not.

        Parameters
        ----------
        taken : ndarray of bool, (Nlocal,)
            Which have.
        new, old, after : ChainState
            The first two have been solved for.
        """
        new_sums, old_sums = self.sums(new.values), self.sums(old.values)
        normals = [one if yes else two for yes, one, two in zip(taken.tolist(), new_sums, old_sums, strict=True)]
        self._sums.of(_key(after.values), lambda: normals)
        there, here = self.beams_given(new), self.beams_given(old)
        pairs = zip(taken.tolist(), there.posteriors, here.posteriors, strict=False)
        posteriors = [one if yes else two for yes, one, two in pairs]
        evidence = np.where(taken, there.log_evidence, here.log_evidence)
        self._given.of(self._key_of(after), lambda: BeamsGiven(normals, posteriors, evidence))

    def drawn(
        self, given: BeamsGiven, chance: Chance, purpose: str, before: Sequence[Array] | None = None
    ) -> tuple[Array, ...]:
        """Draw the beams given all else, E and C as seen by the fit's beams. Collective: the chain's ranks.

        Beams that may not be negative are drawn from where they are ``before``; where they are nowhere yet what comes
        is near a draw, and none of theirs.
        """
        if self.hangs_together:
            return draw_together(self.context, given.together, chance.of(purpose), self.context.problem.priors)
        group, found = self.context.grid.group, []
        for f, channel in enumerate(self.channels):
            beam = None
            if self.context.grid.is_group_root:
                posterior, rng = given.posteriors[f], chance.of(purpose, channel)
                if self.positive is not None and before is not None:
                    beam = self.positive.draw(posterior, before[f], rng)
                else:
                    beam = posterior.draw(rng)
                    beam = beam if self.positive is None else self.positive.nearest(posterior, beam)
            found.append(bcast_array(group, beam))
        return tuple(found)

    def carried(self, here: ChainState, there: ChainState) -> tuple[Array, ...]:
        """Return the beams of one state as far from those that another state's effects expect, in their deviations.

        Collective: the chain's ranks.
        """
        pairs = zip(self.beams_given(here).posteriors, self.beams_given(there).posteriors, strict=True)
        found = [old.carried(beam, new) for beam, (old, new) in zip(here.beams, pairs, strict=False)]
        group, is_root = self.context.grid.group, self.context.grid.is_group_root
        return tuple(bcast_array(group, found[f] if is_root else None) for f in range(len(self.channels)))

    def misfit(self, values: Values, beams: Sequence[Array]) -> FloatArray:
        """Return chi^2 by the stated noise of each channel with E and C as its beam sees them, (Nlocal,).

        Collective: the chain's ranks.
        """
        key = _key(values) + b"".join(one.tobytes() for one in beams)
        return self._misfits.of(key, lambda: self._misfit(values, beams))

    def _misfit(self, values: Values, beams: Sequence[Array]) -> FloatArray:
        if self.collapsed and not self.beam_is_seen:
            # The sums over rows are known already.
            return self.misfit_seen_by_fit(values, beams)
        with together(self.context.grid.world):
            squares, _ = squared_residuals(self.context.train, Estimate(values, self.as_posteriors(beams)))
            total = squares.sum(axis=(1, 2))
        allreduce_sum(self.context.grid.group, total)
        return total

    def as_posteriors(self, beams: Sequence[Array]) -> tuple[Posterior, ...]:
        """Return beams as what the model is made of has them; only the means count."""
        return tuple(replace(one, mean=beam) for one, beam in zip(self.seen_by, beams, strict=True))

    def misfit_seen_by_fit(self, values: Values, beams: Sequence[Array]) -> FloatArray:
        """Return the same with E and C as the fit's beams see them, (Nlocal,). Collective: the chain's ranks."""
        parts = zip(self.sums(values), beams, strict=True)
        return np.array([normal.misfit(BEAM, beam) for normal, beam in parts])

    def log_correction(self, state: ChainState) -> FloatArray:
        """Return ln of the exact density over that with E and C as the fit's beams see them, (Nlocal,).

        Minus infinity where a beam is negative that may not be. Collective: the chain's ranks.
        """
        negative = np.array([self.positive is not None and not self.positive.holds(beam) for beam in state.beams])
        if not self.beam_is_seen:
            return np.where(negative, -np.inf, 0.0)
        more = self.misfit(state.values, state.beams) - self.misfit_seen_by_fit(state.values, state.beams)
        return np.where(negative, -np.inf, -more / state.noise)

    def log_prior(self, state: ChainState) -> float:
        """Return ln of the prior of the effects that move, up to what they do not change."""
        learned, values = self.context.learned, state.values
        of_widths = float(self.unknowns.log_prior_of_widths(values, state.spreads).sum())
        return self.unknowns.log_prior(values) + of_widths + (learned.log_likelihood(values) if learned else 0.0)

    def log_prior_of_beams(self, state: ChainState) -> FloatArray:
        """Return ln of the prior of each channel's beam given the effects, up to a constant, (Nlocal,)."""
        found = []
        for prior, beam in zip(self.priors(state), state.beams, strict=True):
            away = beam - prior.mean
            found.append(-np.vdot(away, prior.precision_times(away)).real / (1 if np.iscomplexobj(beam) else 2))
        return np.array(found)

    def log_likelihood(self, state: ChainState) -> float:
        """Return ln p(d | b, x, s), with d the data as read. Collective: the chain's ranks.

        Of the walk before it was `weighed`.
        """
        if self.parts is not None or self.dof is not None:
            with together(self.context.grid.world):
                total = log_densities(*self.squares(self.context.train, state), self.dof).sum(axis=(1, 2))
            allreduce_sum(self.context.grid.group, total)
            return self.context.over_channels(total)
        exponent = self.misfit(state.values, state.beams) / state.noise
        normals = self.sums(state.values)
        det = [
            one.log_det_inv_noise - one.n_data * np.log(np.pi * s) for one, s in zip(normals, state.noise, strict=True)
        ]
        return self.context.over_channels(np.array(det) - exponent)


def _key(values: Values) -> bytes:
    return b"".join(one.x.tobytes() for one in values.active)


def _widened(prior: Prior, variance: FloatArray) -> Prior:
    assert isinstance(prior, DiagonalPrior)
    return replace(prior, sigma=prior.sigma * np.sqrt(variance))
