"""What the loop found, as ``loop.json`` tells it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.io.formats import FORMAT, LOOP_FORMAT
from hydrabeam_mpi.loop.output.adapted_prior import adapted_told, rounds_alone
from hydrabeam_mpi.loop.output.heldout_change import heldout_change
from hydrabeam_mpi.loop.output.round_record import (
    AtLast,
    known_effects,
    ranked,
    record_of_convention,
    record_of_round,
)
from hydrabeam_mpi.loop.output.sentences import say_predicting, say_verdict, still_there
from hydrabeam_mpi.loop.residuals.left_out import rows_left_out
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.search import given_up
from hydrabeam_mpi.loop.selection.verdict import LEFT_OUT, verdict_of, why_unexplained
from hydrabeam_mpi.setup.findings import Finding

UNDECIDABLE = (
    ("common flux scale", "all fluxes times a number are the same as the beam times that number"),
    ("common gain amplitude", "all gains times a number are the same as the beam times its square"),
    ("common pointing", "all antennas tilted alike are the same as another beam"),
    ("common echo", "echoes alike in all cables are the same as beams that are larger and smaller by channel"),
    ("clock and longitude", "data that were taken later are those of a place further East"),
    (
        "scale of the array and refraction towards the zenith",
        "sources that are R tan(za) nearer to the zenith are seen by baselines that are shorter by R, 0.029% an arcmin",
    ),
)
UNDECIDABLE_LEAKAGE = (
    "common leakage, c in d_e + c and d_n - c*",
    "of a sky that is not polarised, only a difference of the two feeds' beams shows it",
)


def make_record(
    context: FitContext,
    history: History,
    skipped: Sequence[tuple[str, str]],
    conventions: dict[str, Any],
    leakage: dict[str, Any] | None,
    interrupted: bool = False,
) -> dict[str, Any]:
    """Put together ``loop.json``. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    history : History
    skipped : list of (str, str)
        Kinds that were not looked for, and why.
    conventions : dict
        Of `hydrabeam_mpi.loop.checks.conventions.check_conventions`.
    leakage : dict, optional
        Of `hydrabeam_mpi.loop.checks.leakage.check_leakage`: a round, or why there is none.
    interrupted : bool
        Whether this is told of a loop that has not come to its end.

    Returns
    -------
    dict
        JSON-able; the same on all ranks.
    """
    found = _found(context, history, skipped, conventions, leakage, interrupted)
    claimed, kept = history.claimed or history.last, still_there(found["rounds"])
    why = why_unexplained(claimed, history.control, history.n_given)
    verdict = "interrupted" if interrupted else "convention" if conventions["found"] else verdict_of(why, bool(kept))
    # Of data in another convention all is off, and before the last fit what an effect will explain.
    odd = claimed.remains.odd if verdict not in ("convention", "interrupted") else ()
    is_left = verdict == "unexplained" and why != LEFT_OUT
    record: dict[str, Any] = {
        FORMAT: LOOP_FORMAT,
        "name": context.problem.job.name,
        "verdict": verdict,
        "error_before": history.first.score.chi2,
        "error_after": history.last.score.chi2,
        "error_claimed": claimed.score.chi2,
        "heldout_n": history.last.score.n_data,
        **heldout_change(history.first, history.last, context.setup.observation.freqs),
        "why": why if verdict == "unexplained" else None,
        "foreign": _foreign(history),
        **found,
        "prior_widths": [adapted_told(context, one) for one in history.adapted],
        "not_yet_asked": [one["effect"] for one in found["rounds"] if not one.get("asked", True)],
        "last_ranking": [ranked(one) for one in known_effects(history.ranking)],
        "health": [one.record() for one in (*context.problem.findings, *odd)],
        "conventions": conventions,
        "where": claimed.remains.where if is_left else None,
        "residual": history.last.remains.statistics,
        "structures": claimed.remains.structures if is_left else None,
    }
    return {key: _finite(value) for key, value in (record | _said(context, record, kept, odd)).items()}


def _said(
    context: FitContext, record: dict[str, Any], kept: Sequence[dict[str, Any]], odd: Sequence[Finding]
) -> dict[str, Any]:
    """Return what is said of a record in words: what is claimed (``kept``) first, what was taken back since last."""
    sentence = say_verdict(record)
    gone = [one for one in record["rounds"] if one not in kept]
    of_odd = [one.line for one in odd]
    # `summary.json` has these first; of a loop that ends, ``loop.json`` has all that are in that.
    convention = [sentence] if record["conventions"]["found"] else []
    return {
        "sentence": sentence,
        "said": [*(one["sentence"] for one in (*kept, *record["prior_widths"], *gone)), sentence, *of_odd],
        "warnings": [*convention, *say_predicting(record), *context.problem.cautions, *of_odd],
    }


def _found(
    context: FitContext,
    history: History,
    skipped: Sequence[tuple[str, str]],
    conventions: dict[str, Any],
    leakage: dict[str, Any] | None,
    interrupted: bool,
) -> dict[str, Any]:
    """Tell what was found, tried in vain, not looked for, or cannot be decided. Collective: all ranks of the grid."""
    last = history.last.fitted
    at_last = AtLast(last, error_scale(context, last), rows_left_out(context, last), asked=not interrupted)
    rounds = [record_of_round(context, one, at_last) for one in rounds_alone(history)]
    tried = [
        {"effect": one.kind, "law": one.law, "log_bayes_factor": one.log_bayes_factor, "reason": reason}
        for one, reason in history.tried
        if not one.is_control
    ]
    reasons = [{"effect": kind, "reason": reason} for kind, reason in skipped]
    undecidable = [*UNDECIDABLE]
    if leakage is not None:
        # Leakage is seen in rows of its own; in those that are fitted it is of second order, and may look like others.
        place = rounds if "parameters" in leakage else tried if "log_bayes_factor" in leakage else reasons
        place.insert(0, leakage)
        undecidable += [UNDECIDABLE_LEAKAGE] if place is rounds else []
    return {
        "rounds": [record_of_convention(context, history, conventions)] if conventions["found"] else rounds,
        "tried": tried,
        "not_offered_again": [{"effect": kind, "law": law} for kind, law in given_up(history)],
        "skipped": reasons,
        "undecidable": [{"what": what, "why": why} for what, why in undecidable],
    }


def _foreign(history: History) -> dict[str, Any] | None:
    """Tell what explains more than any effect and is none."""
    if history.control is None:
        return None
    candidate = history.control.candidate
    told = {"title": candidate.title, "heldout_after": history.control.after.score.chi2}
    return ranked(candidate) | told


def _finite(value: Any) -> Any:
    """Replace numbers that JSON does not know by null, and NumPy's by Python's."""
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
