"""What the loop found, as ``loop.json`` tells it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import ErrorScale, error_scale
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.io.formats import FORMAT, LOOP_FORMAT
from hydrabeam_mpi.loop.output.adapted_prior import adapted_told, rounds_alone
from hydrabeam_mpi.loop.output.heldout_change import heldout_change
from hydrabeam_mpi.loop.output.parameters import counted, parameters_of, prior_scale_of, widened
from hydrabeam_mpi.loop.output.sentences import say_predicting, say_round, say_verdict, still_there
from hydrabeam_mpi.loop.residuals.left_out import rows_left_out
from hydrabeam_mpi.loop.selection.acceptance import (
    LEFT_OUT,
    Candidate,
    Checked,
    Round,
    indistinguishable,
    verdict_of,
    why_unexplained,
)
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.search import given_up
from hydrabeam_mpi.words import capital

UNDECIDABLE = (
    ("common flux scale", "all fluxes times a number are the same as the beam times that number"),
    ("common gain amplitude", "all gains times a number are the same as the beam times its square"),
    ("common pointing", "all antennas tilted alike are the same as another beam"),
    ("common echo", "echoes alike in all cables are the same as beams that are larger and smaller by channel"),
    ("clock and longitude", "data that were taken later are those of a place further East"),
)
UNDECIDABLE_LEAKAGE = (
    "common leakage, c in d_e + c and d_n - c*",
    "of a sky that is not polarised, only a difference of the two feeds' beams shows it",
)


@dataclass(frozen=True)
class _AtLast:
    """What is told of all rounds by the last fit.

    The scale of errors, which rows are left out, and whether effects have been asked if they are what they say.
    """

    fitted: Fitted
    scale: ErrorScale
    left_out: dict[str, Any] | None
    asked: bool


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
    claimed = history.claimed or history.last
    last, control = claimed.remains, _foreign(history)
    verdict = verdict_of(claimed, history.control, history.n_given, bool(still_there(found["rounds"])))
    if interrupted or conventions["found"]:
        verdict = "interrupted" if interrupted else "convention"
    unexplained = verdict == "unexplained"
    why = why_unexplained(claimed, history.control, history.n_given) if unexplained else None
    is_left = unexplained and why != LEFT_OUT
    # Of data in another convention all is off, and before the last fit what an effect will explain.
    odd = last.odd if verdict not in ("convention", "interrupted") else ()
    record: dict[str, Any] = {
        FORMAT: LOOP_FORMAT,
        "name": context.problem.job.name,
        "verdict": verdict,
        "error_before": history.first.score.chi2,
        "error_after": history.last.score.chi2,
        "error_claimed": claimed.score.chi2,
        "heldout_n": history.last.score.n_data,
        **heldout_change(history.first, history.last, context.setup.observation.freqs),
        "why": why,
        "foreign": control,
        **found,
        "prior_widths": [adapted_told(context, one) for one in history.adapted],
        "not_yet_asked": [one["effect"] for one in found["rounds"] if not one.get("asked", True)],
        "last_ranking": [_ranked(one) for one in known_effects(history.ranking)],
        "health": [one.record() for one in (*context.problem.findings, *odd)],
        "conventions": conventions,
        "where": last.where if is_left else None,
        "residual": history.last.remains.statistics,
        "structures": last.structures if is_left else None,
    }
    record["sentence"] = say_verdict(record)
    kept = still_there(found["rounds"])
    gone = [one for one in found["rounds"] if one not in kept]
    record["said"] = [
        *(one["sentence"] for one in (*kept, *record["prior_widths"], *gone)),
        record["sentence"],
        *(one.line for one in odd),
    ]
    # `summary.json` has these first; of a loop that ends, ``loop.json`` has all that are in that.
    convention = [record["sentence"]] if conventions["found"] else []
    record["warnings"] = [*convention, *say_predicting(record), *context.problem.cautions, *(one.line for one in odd)]
    return {key: _finite(value) for key, value in record.items()}


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
    at_last = _AtLast(last, error_scale(context, last), rows_left_out(context, last), asked=not interrupted)
    rounds = [_round(context, one, at_last) for one in rounds_alone(history)]
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
        "rounds": [_convention(context, history, conventions)] if conventions["found"] else rounds,
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
    return _ranked(candidate) | told


def _finite(value: Any) -> Any:
    """Replace numbers that JSON does not know by null, and NumPy's by Python's."""
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _convention(context: FitContext, history: History, conventions: dict[str, Any]) -> dict[str, Any]:
    """Tell of a broken convention in a round's words; nothing is fitted to it."""
    tested = {one["name"]: one for one in conventions["tested"]}
    name = conventions["found"]
    stated = next(iter(tested.values()))
    right = tested.get(name, stated)
    error = history.first.score.chi2
    health = next((one.why for one in context.problem.findings if one.convention == name), None)
    if health is not None:
        why = f"{capital(health)}."
    elif right is not stated:
        why = f"The model beam's reduced chi^2 is {stated['chi2']:.4g} as stated and {right['chi2']:.4g} so."
    else:
        why = (
            f"{stated['amplitude']:.4g} times as large the model beam explains {stated['explained']:.4%} of the data's "
            "power beyond the noise."
        )
    return {
        "sentence": f"The data follow another convention: {name}. Nothing was fitted to it: {conventions['remedy']}, "
        f"and run the loop again. {why}",
        "effect": f"convention: {name}",
        "title": f"convention: {name}",
        "parameters": [],
        "log_bayes_factor": None,
        "absorbed_by_beam": 0.0,
        "chi2_before": stated["chi2"],
        "chi2_after": right["chi2"],
        "heldout_before": error,
        "heldout_after": error,
        "heldout_sigma": None,
        "runner_up": None,
        "indistinguishable_from": [],
        "ranking": [],
        "residual": None,
    }


def _train_chi2(context: FitContext, checked: Checked) -> float:
    """Return the mean reduced chi^2 of the fitted rows over all channels. Collective: all ranks of the grid."""
    mine = checked.fitted.diagnostics.train_chi2.tolist() if context.grid.is_group_root else []
    return float(np.mean(np.concatenate(context.grid.world.allgather(mine))))


def _round(context: FitContext, one: Round, at_last: _AtLast) -> dict[str, Any]:
    """Tell one round. Collective: all ranks of the grid."""
    setup, candidate, finding = context.setup, one.candidate, one.candidate.finding
    ranking = known_effects(one.ranking)
    # What explains the data together with it is no rival.
    of_set = {candidate.name, *(other.name for other in one.together)}
    others = [other for other in ranking if other.name not in of_set]
    of_heldout = one.evidence_of_all - candidate.log_bayes_factor
    as_good = indistinguishable(candidate, others, context.problem.job.loop, one.evidence_of_rest, of_heldout)
    parameters, not_told = parameters_of(setup, one, at_last.fitted, at_last.scale)
    leaves_out = candidate.weights is not None and candidate.weights.change.leaves_out
    told = {
        "effect": candidate.kind,
        "law": candidate.law,
        "title": candidate.title,
        "parameters": parameters,
        "parameters_not_told": not_told,
        "errors_widened_by": widened(one, at_last.scale),
        "left_out": at_last.left_out if leaves_out else None,
        "of_unknown": candidate.weights is not None and candidate.weights.change.is_of_unknown,
        "log_bayes_factor": candidate.log_bayes_factor,
        "absorbed_by_beam": finding.evidence.absorbed if finding else 0.0,
        "chi2_before": _train_chi2(context, one.before),
        "chi2_after": _train_chi2(context, one.after),
        "heldout_before": one.before.score.chi2,
        "heldout_after": one.after.score.chi2,
        "heldout_sigma": one.sigma,
        "revised": list(one.revised),
        "revoked": one.revoked,
        "predicts": one.predicts,
        "asked": at_last.asked or one.place is None,
        "constancy": [asdict(part) for part in one.constancy],
        "elsewhere": [asdict(other) for other in one.elsewhere],
        "converged": one.after.fitted.diagnostics.converged,
        **heldout_change(one.before, one.after, setup.observation.freqs),
        "runner_up": others[0].kind if others else None,
        "runner_up_law": others[0].law if others else None,
        "runner_up_log_bayes_factor": others[0].of_fitted if others else None,
        "indistinguishable_from": [{"effect": other.kind, "law": other.law} for other in as_good],
        "beam_change_max": one.beam_change,
        "together": [
            {"effect": other.kind, "law": other.law, "log_bayes_factor": other.log_bayes_factor}
            for other in one.together
        ],
        "prior_scale": prior_scale_of(setup, one, at_last.fitted) if finding else None,
        **_size(candidate),
        **(counted(one, at_last.fitted) if finding else {}),
        "ranking": [_ranked(other) for other in ranking],
        "residual": one.before.remains.statistics,
    }
    return {"sentence": say_round(told), **told}


def _size(candidate: Candidate) -> dict[str, Any]:
    """Return how many parameters a candidate has."""
    if candidate.finding is not None:
        evidence = candidate.finding.evidence
        return {
            "n_parameters": evidence.n_parameters,
            "effective_parameters": evidence.effective_parameters,
            "chi2_drop": evidence.chi2_drop,
            "rank": evidence.rank,
        }
    assert candidate.weights is not None
    fit = candidate.weights.fit
    n = fit.n_parameters
    return {
        "n_parameters": n,
        "effective_parameters": float(n),
        "chi2_drop": fit.chi2_drop,
        "rank": n,
    }


def known_effects(ranking: Sequence[Candidate]) -> list[Candidate]:
    """Leave out what is weighed beside the effects and is none."""
    return [one for one in ranking if not one.is_control]


def _ranked(candidate: Candidate) -> dict[str, Any]:
    """Return a candidate's line in the ranking."""
    absorbed = candidate.finding.evidence.absorbed if candidate.finding else 0.0
    line = {
        "effect": candidate.kind,
        "law": candidate.law,
        "log_bayes_factor": candidate.of_fitted,
        "absorbed_by_beam": absorbed,
        **_size(candidate),
    }
    if candidate.weights is not None and candidate.weights.fit.reason:
        line["reason"] = candidate.weights.fit.reason
    return line
