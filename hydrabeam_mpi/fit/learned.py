"""What an earlier result says of beam and effects together: its data, as a Gaussian beside the rows of these data.

The joint posterior of the result in a channel is

    x ~ N(x_0, C),    b | x ~ N(b_0 + M (x - x_0), P^-1),

of the beam's coefficients b and the parameters x of effects that hold in these data too. The beam's prior given the
effects is the second factor, so that its mean moves with them. The first one, over the prior of x in that result, is
the likelihood of x: parameters keep the prior that they had, in the one posterior as in the other. Linearised, the beam
less its mean is as a row of data, b - b_0 - M (x - x_0), with P for its weight.

Channels share some parameters s; given these, what each has of its own is independent of the others. So the density of
all is that of s times that of x_f given s of every channel,

    Q_f = C_f^-1 - (1 - 1/n) (C_ss)^-1

being a channel's part of the precision, of which there are n. What a result was fitted without counts as absent in its
data.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.blocks import EffectBlock
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.state import Active, Estimate, Values
from hydrabeam_mpi.inference.matrices import inverse_of_covariance
from hydrabeam_mpi.inference.prior import DiagonalPrior, FactoredPrior, Prior


@dataclass(frozen=True)
class Learned:
    """What a result says of effects, and of the beam given these.

    Attributes
    ----------
    values : Values
        The effects where the result has them, with the priors that they had; the first ones of every model.
    covariances : tuple of ndarray, (q, q)
        C of each of the job's channels.
    beams : dict of int to FactoredPrior
        Of this rank group's channels by number: that of the beam with the effects at ``values``.
    response : dict of int to ndarray, (n_modes, q)
        M of these channels.
    """

    values: Values
    covariances: tuple[FloatArray, ...]
    beams: Mapping[int, FactoredPrior]
    response: Mapping[int, Array]

    def beam_prior(self, channel: int, values: Values) -> FactoredPrior:
        """Return the prior of a channel's beam given the effects."""
        known = self.beams[channel]
        return replace(known, mean=known.mean + self.response[channel] @ self._away(channel, values))

    def add_to(self, sums: NormalEquations, blocks: Mapping[str, EffectBlock], channel: int, at: Estimate) -> None:
        """Add what is known to a channel's sums over rows, linearised there; the beam's own part is its prior.

        Parameters
        ----------
        sums : NormalEquations
            Of all rows, with ``blocks`` in them.
        blocks : mapping
            By name.
        channel : int
            Among the job's.
        at : Estimate
            Of the channels in ``beams``.
        """
        here, response, beam = self._at(at.values), self.response[channel], self.beam_prior(channel, at.values)
        pull = beam.precision_times(response)
        away = beam.mean - at.beams[list(self.beams).index(channel)].mean
        kappa = 1.0 if sums.blocks[BEAM].is_complex else 2.0
        share = np.where(here.shared, 1 / len(self.covariances), 1.0)
        own, part = share * here.prior_precision(channel), self._parts[channel]
        # Of real parameters sums over rows have half of the precision.
        gram = (response.conj().T @ pull).real / kappa + 0.5 * (part - own)
        score = -part @ self._away(channel, at.values) - share * here.prior_score(channel)
        projection = 0.5 * score - (pull.conj().T @ away).real / kappa
        places = [(name, *place) for name, place in self._places(blocks)]
        for i, (one, span, which) in enumerate(places):
            sums.gram[BEAM, one][:, which] -= pull[:, span] / kappa
            sums.projection[one][which] += projection[span]
            for two, across, those in places[i:]:
                sums.gram[one, two][np.ix_(which, those)] += gram[span, across]

    def log_likelihood(self, values: Values) -> float:
        """Return ln of what the result's data say of the effects, the beam marginalised, up to a constant."""
        here = self._at(values)
        away = [self._away(channel, values) for channel in range(len(self.covariances))]
        quadratic = sum(float(one @ part @ one) for one, part in zip(away, self._parts, strict=True))
        return -0.5 * quadratic - sum(one.prior.log_density(one.x[:, one.used]) for one in here.active)

    def of_prior(self, values: Values, channel: int) -> tuple[FloatArray, FloatArray]:
        """Return precision and score of all that is known beforehand of a channel's parameters in use, (q, q), (q,)."""
        precision, score = values.prior_precision(channel), values.prior_score(channel).copy()
        pairs = zip(self.values.active, values.active, values.spans, strict=False)
        index = np.concatenate([span.start + np.searchsorted(now.used, one.used) for one, now, span in pairs])
        inverse = inverse_of_covariance(self.covariances[channel])
        precision[np.ix_(index, index)] += inverse - self._at(values).prior_precision(channel)
        score[index] -= inverse @ self._away(channel, values) + self._at(values).prior_score(channel)
        return precision, score

    def prior_of(self, place: int, active: Active, channel: int) -> Prior:
        """Return what is known beforehand of one active effect's parameters in use, each by itself."""
        if place >= len(self.values.active):
            return active.prior.of(channel)
        known, span = self.values.active[place], self.values.spans[place]
        mean, std = np.zeros(active.size), active.prior.of(channel).std().copy()
        index = np.searchsorted(active.used, known.used)
        mean[index] = known.x[channel, known.used]
        std[index] = np.sqrt(np.diag(self.covariances[channel])[span])
        return DiagonalPrior(mean, std)

    def joined(self, active: Iterable[Active]) -> tuple[Active, ...]:
        """Put the effects before those of a job, which has them too if it was written after they were known.

        Raises
        ------
        InputError
            If the job leaves out some of their parameters.
        """
        others, first = list(active), []
        for one in self.values.active:
            same = [two for two in others if two.kind == one.kind and two.effect.describe() == one.effect.describe()]
            if same and not np.isin(one.used, same[0].used).all():
                told = f"{one.kind} lacks parameters that are known from the result in [prior] file"
                raise InputError(told, field="[[effects]]", remedy="leave the effect out of the job")
            others = [two for two in others if not same or two is not same[0]]
            # Combinations that no data decide have been decided by the result.
            first.append(replace(same[0], degenerate_directions=one.degenerate_directions) if same else one)
        return (*first, *others)

    def _places(self, blocks: Mapping[str, EffectBlock]) -> Iterable[tuple[str, tuple[slice, IntArray]]]:
        """Yield which blocks are about these parameters: about which ones here, and where they are in the block."""
        for (name, one), span in zip(self.values.blocks.items(), self.values.spans, strict=True):
            yield name, (span, np.searchsorted(blocks[name].used, one.used))

    def _at(self, values: Values) -> Values:
        """Return these effects with the parameters that they have in a model."""
        pairs = zip(self.values.active, values.active, strict=False)
        return Values(tuple(replace(one, x=now.x) for one, now in pairs))

    def _away(self, channel: int, values: Values) -> FloatArray:
        """Return x - x_0 of a channel, (q,)."""
        away: FloatArray = (self._at(values).x - self.values.x)[channel]
        return away

    @cached_property
    def _parts(self) -> Sequence[FloatArray]:
        """Q of each channel."""
        shared = np.flatnonzero(self.values.shared)
        parts = [inverse_of_covariance(covariance) for covariance in self.covariances]
        common = inverse_of_covariance(self.covariances[0][np.ix_(shared, shared)])
        for part in parts:
            part[np.ix_(shared, shared)] -= (1 - 1 / len(parts)) * common
        return parts
