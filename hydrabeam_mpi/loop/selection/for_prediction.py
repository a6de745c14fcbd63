"""What cannot be claimed may still predict: effects that were taken back stay in the model where held-out data want it.

Whether an effect may be claimed is a question of words: is it the same in all parts of the data, and told from what is
left? What is in the model that predicts is a question of the score of data that were not fitted. Where more is left
than claimed effects explain, a model without what was taken back predicts worse, and its beam takes up what that stood
for.
"""

from __future__ import annotations

from dataclasses import replace

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.loop.selection.folds import compared
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.loop.selection.refusal import refusal_by_heldout
from hydrabeam_mpi.loop.selection.verdict import why_unexplained
from hydrabeam_mpi.terminal.progress import say


def keep_for_prediction(context: FitContext, history: History) -> None:
    """Give effects that cannot be claimed back to the model where held-out data are predicted better with them.

    One after the other, as they were found, by the rule by which they were added, and where the rms of the held-out
    residual does not rise at all: there is no claim that would be worth that. Where the data are explained by what is
    claimed nothing is given back. Collective: all ranks of the grid.
    """
    if why_unexplained(history.last, history.control, history.n_given) is None:
        return
    settings, claimed = context.problem.job.loop, history.last
    for number, one in enumerate(history.rounds):
        if one.taken_back is None or not one.may_predict:
            continue
        before, (active, _) = history.last, one.taken_back
        values = before.fitted.values.extended(active)
        try:
            after = check(context, fit_patiently(context, values, before.fitted))
        except BrokenOff:
            continue
        rises = after.numbers.of_all["rms"] > before.numbers.of_all["rms"]
        if rises or refusal_by_heldout(*compared(context, before, after), settings) is not None:
            continue
        told = f"{one.candidate.title}: not claimed, but in the model again, which predicts held-out data better so"
        change = f"chi^2 {before.score.chi2:.4g} -> {after.score.chi2:.4g}"
        say(f"  {told} ({change}, rms {after.numbers.of_all['rms']:.4g} Jy)", context.grid.is_world_root)
        history.rounds[number] = replace(one, place=len(values.active) - 1, taken_back=None)
        history.last, history.claimed = after, claimed
    if history.claimed is not None:
        history.rounds[-1] = replace(history.rounds[-1], after=history.last)
