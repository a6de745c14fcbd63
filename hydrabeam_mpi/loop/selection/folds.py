"""Cross-validation: where one split of the data has not decided, the held-out rows predict the fitted ones as well."""

from __future__ import annotations

from dataclasses import replace

from hydrabeam_mpi.config.effects import Loop as LoopSettings
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.heldout_numbers import heldout_numbers
from hydrabeam_mpi.loop.selection.heldout_score import gain_error, gain_of
from hydrabeam_mpi.loop.selection.predictions import score_of
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.terminal.progress import say


def compared(context: FitContext, before: Checked, after: Checked) -> tuple[Checked, Checked]:
    """Return two fits to compare, with the scores of both folds of the data where one has not decided between them.

    Few data say little: an effect that is there may make the prediction of one half worse by chance, and one that is
    not make it better. Each of the two models is then fitted to the rows that were held out, from where it is and with
    the priors that it has, and predicts those that were fitted. The sum over both folds is the score of all data, each
    predicted from others. Where one of these fits does not converge, how well it predicts says nothing of its model:
    then one fold is all that is known.

    Collective: all ranks of the grid.
    """
    settings, speaks = context.problem.job.loop, context.grid.is_world_root
    gain, error = gain_of(before.score, after.score), gain_error(before.score, after.score)
    if is_decided(gain, error, settings):
        return before, after
    told = f"    held-out ln density changes by {gain:.4g} +- {error:.2g}"
    one, two = _with_other_fold(context, before), _with_other_fold(context, after)
    if one is None or two is None:
        say(f"{told}; fits of the held-out rows, to predict the fitted ones, do not converge", speaks)
        return before, after
    of_both = f"with the fitted rows predicted from the held-out ones as well: by {gain_of(one.score, two.score):.4g}"
    say(f"{told}; {of_both}", speaks)
    return one, two


def is_decided(gain: float, error: float, settings: LoopSettings) -> bool:
    """Whether a gain, or a loss, is more than a job asks for, and by more than it may be off by chance."""
    return not abs(gain) <= settings.min_log_bayes_factor + RULES.decided_sigmas * error


def _with_other_fold(context: FitContext, checked: Checked) -> Checked | None:
    """Add the score of the fitted rows, predicted from the held-out ones; None where these cannot be fitted.

    Collective: all ranks of the grid.

    All that is tried is compared with the same model, and the best of it is the one that comes next.
    """
    return context.of_latest("other fold", checked, lambda: _predicted_from_the_other(context, checked), kept=3)


def _predicted_from_the_other(context: FitContext, checked: Checked) -> Checked | None:
    other = context.exchanged
    try:
        fitted = fit_patiently(other, checked.fitted.values, checked.fitted)
        if not fitted.diagnostics.converged:
            return None
        score = score_of(other, fitted)
    except BrokenOff:
        return None
    numbers = heldout_numbers(other, fitted)
    return replace(checked, score=checked.score + score, numbers=checked.numbers + numbers)
