"""How much memory a rank's share of a loop needs: what a fit needs, and the columns of all that is weighed beside it.

How many columns there are the effects themselves tell, with as many candidates picked as a search picks at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.fit.joint import setup_of
from hydrabeam_mpi.fit.memory import Share, fit_bytes
from hydrabeam_mpi.fit.rank_data import times_at_once
from hydrabeam_mpi.fit.room import COMPLEX, REAL
from hydrabeam_mpi.loop.attribution.control_models import control_models
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.choice import choose
from hydrabeam_mpi.loop.selection.known_beforehand import known_effects
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.setup.problem import Problem

PRODUCTS = 4
"""Matrices of a candidate's own columns that are there at once: their products, what the beam takes up of them, and
these with and without it."""
DECIDED = 6
"""The same of the one that is being decided about: its eigenvectors, and what they are worked out in."""
AT_ONCE = 3
"""Copies of a block's columns: as made, weighted, and one of their two parts."""


@dataclass(frozen=True)
class Candidates:
    """What a loop weighs at once.

    Attributes
    ----------
    weighed, again : ndarray of int, (Neffects,)
        Parameters of each effect that is weighed; and of those of which many candidates are looked at again before.
    by_group : int
        The most parameters whose columns are numbers of each group of baselines; those of others are mostly zero.
    integrated : int
        Numbers that are integrated over the sky for each group and kept.
    more : int
        Further functions that the beam may get.
    known : int
        Parameters of what is part of the model beforehand, beside which all is weighed.
    changes_sky : bool
        Whether there is an effect that changes the sky, of which the designs are kept as well.
    """

    weighed: IntArray
    again: IntArray
    by_group: int
    integrated: int
    more: int
    known: int
    changes_sky: bool

    @classmethod
    def of(cls, effects: Sequence[Effect], setup: ObservingSetup, beam: Beam, known: Sequence[Effect] = ()) -> Self:
        """Ask the effects that are looked for, and those that are known beforehand."""
        picked = [_picked(one, setup) for one in effects]
        again = [one for effect in effects if (one := _again(effect, setup)) is not None]
        sizes, sizes_again = (np.array([len(one.parameters(setup)) for one in some], int) for some in (picked, again))
        seen_alike = [one.is_by_group for one in (*picked, *again)]
        of_beam = [more for one in effects if one.beam_functions(setup) for more in (one, *one.larger(setup))]
        return cls(
            sizes,
            sizes_again,
            int(np.max(np.concatenate([sizes, sizes_again]) * seen_alike, initial=0)),
            _integrated(picked, setup, beam),
            max((len(one.parameters(setup)) for one in of_beam), default=0),
            sum(min(len(one.parameters(setup)), RULES.most_known) for one in known),
            any(one.changes_sky for one in picked),
        )


def candidates_of(problem: Problem) -> Candidates:
    """Return what a loop over a problem, of all its channels, weighs at once."""
    setup = setup_of(problem, problem.observation.pols)
    effects = [*choose(problem.job, setup).effects, *control_models(setup)]
    known = known_effects(problem.job, setup)
    return Candidates.of(effects, setup, problem.beams[0], known)


def loop_bytes(problem: Problem, share: Share, root: bool) -> int:
    """Return the bytes that a rank needs for a loop until all effects have been weighed once."""
    return fit_bytes(share, root, weighing_bytes(candidates_of(problem), share))


def weighing_bytes(candidates: Candidates, share: Share) -> int:
    """Return the bytes that a rank needs besides its rows while effects are weighed."""
    n_times = min(times_at_once(share.baselines), share.train_times)
    n_kept = share.train_times if share.room(share.train_times).designs else n_times
    blocks = COMPLEX * share.groups * n_kept * candidates.integrated
    # A block of one time is the design as it is kept.
    blocks += share.design // share.channels * n_kept if n_times > 1 else 0
    blocks *= share.channels if share.room(share.train_times).designs else 1
    made = 0 if share.room(share.train_times).designs else share.making_design
    columns = made + AT_ONCE * COMPLEX * share.groups * n_times * candidates.by_group
    return blocks + max(
        _deciding(sizes, candidates.known, share, columns) for sizes in (candidates.weighed, candidates.again)
    )


def _deciding(sizes: IntArray, known: int, share: Share, columns: int) -> int:
    """Return the bytes of sums over the columns of effects of some sizes, while the last are added or decided about.

    There are so many parameters ``known`` beforehand. In each channel they have products with all others, and while an
    effect is decided about they are there with its own, in all channels.
    """
    squares, beside = REAL * sizes**2, REAL * known * int(sizes.sum())
    sums = PRODUCTS * int(squares.sum()) + 2 * share.item * share.basis.n_modes * int(sizes.sum()) + PRODUCTS * beside
    other_channels = (share.channels - 1) * (2 * int(squares.sum()) + beside + 2 * REAL * known**2)
    whole = REAL * known * (known + 2 * int(sizes.max(initial=0)))
    deciding = DECIDED * int(squares.max(initial=0)) + 2 * (1 + share.channels) * whole
    return sums + other_channels + max(deciding, columns)


def further_bytes(candidates: Candidates, share: Share) -> int:
    """Return the bytes that what is found may need besides: the first that changes the sky, or each batch of modes."""
    of_sky = share.kept_designs if candidates.changes_sky else 0
    kept = [times for times in (share.train_times, share.test_times) if share.room(times).designs]
    return max(of_sky, 2 * COMPLEX * share.channels * share.groups * sum(kept) * candidates.more)


def _spread(effect: ScannedEffect, setup: ObservingSetup) -> IntArray:
    """Return as many of an effect's candidates as are compared, evenly spread over all."""
    n = effect.n_hypotheses(setup)
    return np.unique(np.linspace(0, n - 1, min(n, effect.most_again)).astype(int)) if n else np.zeros(0, int)


def _picked(effect: Effect, setup: ObservingSetup) -> Effect:
    """Return an effect with the candidates that are weighed, whichever they are."""
    return effect.at(setup, _spread(effect, setup)) if isinstance(effect, ScannedEffect) else effect


def _again(effect: Effect, setup: ObservingSetup) -> Effect | None:
    """Return an effect with the candidates that are looked at again; None where none are."""
    if not isinstance(effect, ScannedEffect):
        return None
    return effect.every(setup, effect.expanded(setup, _spread(effect, setup))[: effect.most_again])


def _integrated(effects: Sequence[Effect], setup: ObservingSetup, beam: Beam) -> int:
    """Return how many numbers of each group are integrated for effects; see `Effect.integrated_as`."""
    one, at = np.ones(1), np.full(1, 0.5)
    source = Sources(np.zeros(1, int), at, at, one, beam, freq=float(setup.observation.freqs[0]))
    columns = {effect.integrated_as: effect.sky_columns(source) for effect in effects}
    of_sky = sum(len(found) for found in columns.values() if found is not None)
    # Functions of the beam are kept beside what other skies change of them.
    functions = [effect.beam_functions(setup) for effect in effects]
    return of_sky + 2 * sum(one.n_modes for one in functions if one is not None)
