"""What a round found, as ``loop.json`` tells it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import ErrorScale
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.output.heldout_change import heldout_change
from hydrabeam_mpi.loop.output.parameters import counted, parameters_of, prior_scale_of, widened
from hydrabeam_mpi.loop.output.sentences import say_round
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round, indistinguishable
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.words import capital


@dataclass(frozen=True)
class AtLast:
    """What is told of all rounds by the last fit.

    The scale of errors, which rows are left out, and whether effects have been asked if they are what they say.
    """

    fitted: Fitted
    scale: ErrorScale
    left_out: dict[str, Any] | None
    asked: bool


def record_of_round(context: FitContext, one: Round, at_last: AtLast) -> dict[str, Any]:
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
        "ranking": [ranked(other) for other in ranking],
        "residual": one.before.remains.statistics,
    }
    return {"sentence": say_round(told), **told}


def record_of_convention(context: FitContext, history: History, conventions: dict[str, Any]) -> dict[str, Any]:
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


def known_effects(ranking: Sequence[Candidate]) -> list[Candidate]:
    """Leave out what is weighed beside the effects and is none."""
    return [one for one in ranking if not one.is_control]


def ranked(candidate: Candidate) -> dict[str, Any]:
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


def _train_chi2(context: FitContext, checked: Checked) -> float:
    """Return the mean reduced chi^2 of the fitted rows over all channels. Collective: all ranks of the grid."""
    mine = checked.fitted.diagnostics.train_chi2.tolist() if context.grid.is_group_root else []
    return float(np.mean(np.concatenate(context.grid.world.allgather(mine))))
