"""How the widths of the beam's prior were adapted, as ``loop.json`` tells it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.prior_widths import as_stated
from hydrabeam_mpi.loop.output.heldout_change import heldout_change
from hydrabeam_mpi.loop.output.sentences import say_adapted
from hydrabeam_mpi.loop.selection.acceptance import Round
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.prior_widths import Adapted, describe
from hydrabeam_mpi.setup.beams import stated_widths


def adapted_told(context: FitContext, one: Adapted) -> dict[str, Any]:
    """Tell what was decided, and how near the held-out data are predicted before and after."""
    told = {
        "words": describe(one.widths),
        "log_bayes_factor": one.log_bayes_factor,
        "n_rounds": one.n_rounds,
        **as_stated(one.widths or stated_widths(context.problem.job)),
        "shape": context.problem.job.prior.has_shape,
        "wider": one.wider,
        "n_beyond": one.beyond.n,
        "log_bayes_factor_beyond": one.beyond.log_bayes_factor,
        **heldout_change(one.before, one.after, context.setup.observation.freqs),
    }
    del told["heldout_channels"]
    return {"sentence": say_adapted(told), **told}


def rounds_alone(history: History) -> list[Round]:
    """Return the rounds with the fits that their own effects have led to, before widths were adapted after them."""
    led_to = {one.n_rounds: one.before for one in reversed(history.adapted)}
    return [replace(one, after=led_to.get(number, one.after)) for number, one in enumerate(history.rounds, 1)]
