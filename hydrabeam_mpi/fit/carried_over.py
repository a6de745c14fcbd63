"""What a fit to some data says of others: beams, and the effects that hold there, with their errors.

The coefficients b of a beam and the parameters x of effects have been inferred jointly,

    x ~ N(x_0, C),    b | x ~ N(b_0 + M (x - x_0), P^-1),        so that        cov(b) = P^-1 + M C M^H.

Of x only a part k may hold in other data. Given that part the beam is as uncertain as the rest of x leaves it,

    M_k = (M C)_k C_kk^-1,    cov(b | x_k) = cov(b) - M_k C_kk M_k^H.

Where other data have elements that these lacked, such as a further antenna, their parameters are known by their prior.
So are those of an effect that is there in other data, too, but not as it was found, such as a gain that drifts anew
each night: what it may be counts among the errors.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from hydrabeam_mpi.config.effects import Effect as EffectEntry
from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import EFFECTS, make_effect, make_reweighting
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.state import Active, Values, independent_prior
from hydrabeam_mpi.fit.whitening import root_of
from hydrabeam_mpi.inference.matrices import inverse_where_it_varies
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import ChannelPrior
from hydrabeam_mpi.io.inferred import REMEDY, Inferred
from hydrabeam_mpi.mpi import ProcessGrid, bcast_array, together
from hydrabeam_mpi.words import counted, joined

Array = NDArray[Any]

UNTOLD = 0.99
"""Of the prior's standard deviation: data that leave so much of it have told a hundredth of a nat of a parameter,
which is nothing. Rounding, and what parameters have in common, leave it just below one where no data are."""
MOST_NAMED = 6
"""Parameters that a line has room for; the summary has all."""


@dataclass(frozen=True)
class CarriedOver:
    """The effects of a result in other data.

    Attributes
    ----------
    values : Values
        At the parameters that were found, of all the result's channels.
    kept : ndarray of int, (k,)
        Which of the result's parameters in use hold here, all effects side by side.
    place : ndarray of int, (k,)
        Their numbers among those in use here.
    sign : ndarray, (k,)
        -1 where one counts in the opposite sense here.
    carried, left : tuple of dict
        What holds here and what does not, in words: ``effect``, ``title``, names of ``parameters``, and of what does
        not the ``reason``.
    at_prior : tuple of str
        Parameters here of which the result knows the prior alone.
    assumed : str, optional
        What is taken for granted of the beam, where these data are of the other feed.
    """

    values: Values
    kept: IntArray
    place: IntArray
    sign: FloatArray
    carried: tuple[dict[str, Any], ...]
    left: tuple[dict[str, Any], ...]
    at_prior: tuple[str, ...]
    assumed: str | None = None

    @property
    def lines(self) -> list[str]:
        """What is said of the effects."""
        counts = [(one["title"], counted(len(one["parameters"]), "parameter")) for one in self.carried]
        lines = [f"carried over: {title} ({n})" for title, n in counts]
        for one in self.left:
            n = len(one["parameters"])
            what = f" ({', '.join(one['parameters']) if n <= MOST_NAMED else counted(n, 'parameter')})" if n else ""
            lines.append(f"not carried over: {one['title']}{what}, which {one['reason']}")
        if self.assumed:
            lines.insert(0, self.assumed)
        of = Counter(name.split(": ", 1)[0] for name in self.at_prior)
        unknown = joined([f"{title} ({counted(n, 'parameter')})" for title, n in of.items()])
        told = "not known from the result: what may be so counts as an error, by its prior, and is not predicted"
        return [*lines, f"{told}: {unknown}"] if unknown else lines

    @property
    def summary(self) -> dict[str, Any]:
        """What is told of the effects."""
        return {
            "carried_over": list(self.carried),
            "not_carried_over": list(self.left),
            "at_prior": list(self.at_prior),
            **({"assumed": self.assumed} if self.assumed else {}),
        }

    def at_prior_too(self, setup: ObservingSetup, untold: BoolArray) -> CarriedOver:
        """Return the same where the result's own data told nothing of some of the parameters in use here, (q_here,)."""
        titles = [(one.effect.title, name) for one in self.values.active for name, _ in one.labels(setup)]
        lost = {titles[i]: f"{titles[i][0]}: {titles[i][1]}" for i in np.flatnonzero(untold).tolist()}
        left = (
            {**one, "parameters": [name for name in one["parameters"] if (one["title"], name) not in lost]}
            for one in self.carried
        )
        at_prior = tuple(dict.fromkeys((*self.at_prior, *lost.values())))
        return replace(self, carried=tuple(one for one in left if one["parameters"]), at_prior=at_prior)

    def fit(
        self, channel: int, mean: Array, covariance: Array, arrays: Mapping[str, Array]
    ) -> tuple[Posterior, FloatArray, Array]:
        """Return a channel's beam given the effects, the effects' covariance, and the beam's response to them.

        Parameters
        ----------
        channel : int
            Among the result's.
        mean, covariance : ndarray, (n_modes,) and (n_modes, n_modes)
            Of the beam with all that effects add to its basis, the effects marginalised.
        arrays : mapping
            ``effects_covariance``, (q, q), and ``effects_beam_response``, (m, q); neither without effects.

        Returns
        -------
        beam : Posterior
            Of m coefficients.
        covariance : ndarray, (q_here, q_here)
        response : ndarray, (m, q_here)

        Raises
        ------
        InputError
            If these are no joint covariance.
        """
        spread = arrays.get("effects_covariance", np.zeros((0, 0)))
        response = arrays.get("effects_beam_response", np.zeros((len(mean), 0)))
        if len(spread) <= self.kept.max(initial=-1):
            raise InputError("has fewer effects than are told of", field="effects_covariance", remedy=REMEDY)
        own = spread[np.ix_(self.kept, self.kept)]
        if len(self.kept) < len(spread):
            response = response @ spread[:, self.kept] @ inverse_where_it_varies(own)
        half, m = response @ root_of(own), len(response)
        try:
            beam = Posterior.of(mean[:m], covariance[:m, :m] - half @ half.conj().T)
        except np.linalg.LinAlgError as error:
            raise InputError("is no covariance", field="covariance", remedy=REMEDY) from error
        here = np.diag(np.square(self.values.prior_std(channel)))
        here[np.ix_(self.place, self.place)] = own * self.sign * self.sign[:, np.newaxis]
        follow = np.zeros((m, len(here)), dtype=response.dtype)
        follow[:, self.place] = response * self.sign
        return beam, here, follow


def untold(covariance: FloatArray, prior_std: FloatArray) -> BoolArray:
    """Return of which parameters of a covariance, (q, q), and of widths of their prior, (q,), no data have told."""
    return np.asarray(np.diag(covariance) > np.square(UNTOLD * prior_std))


def carry_over(found: Iterable[Mapping[str, Any]], setup: ObservingSetup, other_feed: str | None = None) -> CarriedOver:
    """Return the effects of a result as other data have them.

    Parameters
    ----------
    found : iterable of mapping
        The ``entries`` of ``posterior.h5``.
    setup : ObservingSetup
        Of the other data, with all of the result's channels.
    other_feed : str, optional
        What is assumed of the beam where the data are of the other feed, which has those effects alone that are of the
        sky or of both feeds.

    Raises
    ------
    InputError
        If they are not what a result says of effects.
    """
    active: list[Active] = []
    kept, place, sign = np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0)
    carried, left, at_prior = [], [], []
    before = after = 0
    for number, told in enumerate(found):
        entry, known = _entry(told, number, setup)
        cause = make_effect(entry.kind, entry.settings) if entry.kind in EFFECTS else make_reweighting(entry.kind, {})
        words, here = {"effect": cause.kind, "title": cause.title}, cause.carried_over(setup)
        if other_feed and isinstance(here, Effect) and not (here.of_the_sky or here.of_both_feeds):
            here = "is of the other feed"
        lacking = list(entry.names)
        if isinstance(here, Effect):
            one, match = _active(here, setup, entry, known)
            names = here.parameters(setup).names
            if len(match.kept):
                kept, sign = np.append(kept, before + match.kept), np.append(sign, match.sign)
                place = np.append(place, after + np.searchsorted(one.used, match.place))
                active.append(one)
                after += one.size
                carried.append({**words, "parameters": [names[i] for i in np.sort(match.place)]})
                at_prior += [f"{here.title}: {names[i]}" for i in np.setdiff1d(one.used, match.place)]
            lacking = [name for i, name in enumerate(entry.names) if i not in match.kept]
        elif not other_feed and isinstance(cause, Effect) and (again := _anew(cause, setup, entry)):
            active.append(again)
            after += again.size
            at_prior += [f"{cause.title}: {name}" for name, _ in again.labels(setup)]
        if lacking or not isinstance(here, Effect):
            reason = here if isinstance(here, str) else _why_lacking(here)
            left.append({**words, "parameters": lacking, "reason": reason})
        before += len(entry.names)
    return CarriedOver(
        Values(tuple(active)), kept, place, sign, tuple(carried), tuple(left), tuple(at_prior), other_feed
    )


def share_fit(
    grid: ProcessGrid, result: Inferred | None, carried: CarriedOver, number: int
) -> tuple[Posterior, FloatArray, Array]:
    """Return what `CarriedOver.fit` does for a channel of the result, on all ranks. Collective: all ranks of the grid.

    The ``result`` is needed on rank 0 alone.
    """
    parts: tuple[Array | None, ...] = (None,) * 4
    with together(grid.world):
        if result and grid.is_world_root:
            arrays = result.content.channels[number].arrays
            with result.telling():
                beam, covariance, response = carried.fit(number, arrays["mean"], result.covariance_of(number), arrays)
            parts = beam.mean, beam.factor, covariance, response
    mean, factor, covariance, response = (bcast_array(grid.world, part) for part in parts)
    return Posterior(mean, factor), covariance, response


def _entry(told: Mapping[str, Any], number: int, setup: ObservingSetup) -> tuple[EffectEntry, frozenset[str]]:
    """Return what is told of an effect, and the names of all parameters that it had in the result's data."""
    field, n_freqs = f"effects, number {number + 1}", setup.observation.Nfreqs
    try:
        known = frozenset(map(str, told.get("known", ())))
        content = {name: value for name, value in told.items() if name != "known"}
        entry = EffectEntry.model_validate_json(json.dumps(content))
    except (AttributeError, TypeError, ValidationError) as error:
        raise InputError("is not understood", field=field, remedy=REMEDY) from error
    if len(entry.values) != n_freqs or len(entry.prior_std) not in (0, 1, n_freqs):
        raise InputError(f"has not the values of {n_freqs} channels", field=field, remedy=REMEDY)
    return entry, known


def _why_lacking(effect: Effect) -> str:
    if effect.local == "times":
        return "belongs to times of the data in which it was found"
    return "is of what these data do not have"


class _Match(NamedTuple):
    """Which of the result's parameters in use are here, (k,), their numbers among all here, and with which sign."""

    kept: IntArray
    place: IntArray
    sign: FloatArray


def _active(effect: Effect, setup: ObservingSetup, entry: EffectEntry, known: frozenset[str]) -> tuple[Active, _Match]:
    """Return an effect at the values that were found, and where these have gone.

    Where all elements of the result's data were in use a further one has their prior. Where a few were found to be at
    fault among many it has none, and is as the others.
    """
    parameters = effect.parameters(setup)
    numbers = effect.known_as(parameters.names)
    found = [(i, *numbers[name]) for i, name in enumerate(entry.names) if name in numbers]
    kept, place = np.array([one[:2] for one in found], dtype=int).reshape(-1, 2).T
    match = _Match(kept, place, np.array([sign for *_, sign in found]))
    x, prior_std = (np.zeros((len(rows), len(parameters))) for rows in (entry.values, entry.prior_std))
    x[:, place] = np.array(entry.values)[:, kept] * match.sign
    prior_std[:, place] = np.array(entry.prior_std)[:, kept]
    if len(entry.names) == len(known) and len(kept):
        familiar = [number for name, (number, _) in numbers.items() if name in known]
        unknown = np.setdiff1d(np.arange(len(parameters)), familiar)
        widths = (prior_std[:, place] / parameters.scale[place]).max(axis=1)
        prior_std[:, unknown] = widths[:, np.newaxis] * parameters.scale[unknown]
    return _with_prior(effect, setup, x, np.square(prior_std)), match


def _anew(effect: Effect, setup: ObservingSetup, entry: EffectEntry) -> Active | None:
    """Return what is there of an effect that does not hold as it was found, at zero and as large as it was; or None."""
    found = effect.anew(setup)
    if found is None:
        return None
    here, sizes = found
    there = {name: np.square(std) for name, std in zip(entry.names, np.array(entry.prior_std).T, strict=True)}
    prior_var = np.zeros((len(entry.prior_std), len(here.parameters(setup))))
    for number, name in enumerate(here.parameters(setup).names):
        for other, share in sizes[name].items():
            prior_var[:, number] += share * there.get(other, 0.0)
    active = _with_prior(here, setup, np.zeros((len(entry.values), prior_var.shape[1])), prior_var)
    return active if active.size else None


def _with_prior(effect: Effect, setup: ObservingSetup, x: FloatArray, prior_var: FloatArray) -> Active:
    """Return an effect with variances of its prior in each channel, (Nfreqs, n_params), zero for what is not in use."""
    parameters = effect.parameters(setup)
    priors = [independent_prior(one, effect.shared) for one in prior_var[: 1 if effect.shared else None]]
    prior = ChannelPrior(tuple(one.of(0) for _, one in priors), effect.shared)
    limits = np.where(parameters.nonlinear, parameters.scale, np.inf)
    return Active(effect, priors[0][0], prior, x, limits, np.zeros((0, len(parameters))))
