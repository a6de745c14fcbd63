"""How wide the beam's prior is, is no finding, but the data decide it as they decide what is one: by the evidence.

While effects are looked for first the beam is as free as the job states, or freer where the data want that: no width
gets less than the stated one, unless that has more evidence than any effect. Then the prior has the widths that the
data want, where held-out data agree: for prediction, and to look for what a beam that was too free had taken up. The
beams of several channels must be free to be off alike for either; see `selection.search`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.prior_widths import adapted, is_adaptable
from hydrabeam_mpi.fit.widths_evidence import WidthsEvidence, WidthsFound
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.beyond_basis import (
    NONE_BEYOND,
    Beyond,
    with_functions_beyond,
    with_rest_of_model,
)
from hydrabeam_mpi.loop.selection.folds import compared
from hydrabeam_mpi.loop.selection.heldout_score import gain_of
from hydrabeam_mpi.loop.selection.known_beforehand import may_be_off_alike
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.terminal.progress import say


@dataclass(frozen=True)
class Adapted:
    """Fits before and after the beam's prior was adapted.

    Attributes
    ----------
    before, after : Checked
    log_bayes_factor : float
        Of the widths beside the stated ones.
    n_rounds : int
        How many rounds there were before.
    wider : bool
        Whether no width could get less than the stated one.
    beyond : Beyond
        The functions beyond its basis that the beam got.
    """

    before: Checked
    after: Checked
    log_bayes_factor: float
    n_rounds: int
    wider: bool
    beyond: Beyond = NONE_BEYOND

    @property
    def is_of_widths(self) -> bool:
        """Whether the beam's prior got other widths, and not functions alone."""
        return self.widths != self.before.fitted.values.prior_widths

    @property
    def widths(self) -> PriorWidths | None:
        """The new ones; None where they are the stated ones."""
        return self.after.fitted.values.prior_widths


def adapt(
    context: FitContext,
    checked: Checked,
    n_rounds: int,
    wider: bool,
    effects: Sequence[Effect] = (),
    rivals: Sequence[Candidate] = (),
) -> Adapted | None:
    """Give the beam's prior what has the most evidence; None where it has that, or where a rival has more.

    That is its widths, and functions beyond its basis: what of the ``effects`` no beam in it can follow. A beam that is
    further from its model than was stated is told from an effect that it takes up as effects are told from each other.
    Held-out data must not be predicted worse. With ``wider`` no width gets less than the stated one unless that has
    more evidence than any rival: what is off may be how freedom is shared out among coefficients. Collective: all ranks
    of the grid.
    """
    job = context.problem.job
    if job.prior.widths == "stated" or not is_adaptable(context):
        return None
    rivals = [one for one in rivals if not one.is_control]
    widened, log_bayes_factor, wider = _with_widths(context, checked, wider, rivals)
    after, beyond = with_functions_beyond(context, widened, effects, rivals)
    return None if after is checked else Adapted(checked, after, log_bayes_factor, n_rounds, wider, beyond)


def adapt_to_model(context: FitContext, checked: Checked, effects: Sequence[Effect]) -> Adapted | None:
    """Give the beam what its basis leaves of the model beam; None where the data do not want that.

    Arguments are as of `adapt`. Collective: all ranks of the grid.
    """
    if context.problem.job.prior.widths == "stated" or not is_adaptable(context):
        return None
    after, beyond = with_rest_of_model(context, checked, effects)
    return None if after is checked else Adapted(checked, after, 0.0, 0, wider=True, beyond=beyond)


def as_adapted(context: FitContext, found: Round, n_rounds: int, wider: bool) -> Adapted | None:
    """Tell a round that gives the beam nothing but functions beyond its basis as what it is; None for any other."""
    finding = found.candidate.finding
    part = None if finding is None else finding.effect.beyond_basis(context.setup)
    given = found.after.fitted.values.active
    is_beyond = part is not None and given[-1].used.max() < len(part.parameters(context.setup))
    if not is_beyond or context.problem.job.prior.widths == "stated":
        return None
    beyond = Beyond(given[-1].size, found.candidate.log_bayes_factor)
    return Adapted(found.before, found.after, 0.0, n_rounds, wider, beyond)


def _with_widths(
    context: FitContext, checked: Checked, wider: bool, rivals: Sequence[Candidate]
) -> tuple[Checked, float, bool]:
    """Return the fit with the widths that `adapt` wants, their log Bayes factor, and whether none could get less."""
    alike = may_be_off_alike(context, checked.fitted.values)
    least = max([context.problem.job.loop.min_log_bayes_factor, *(one.log_bayes_factor for one in rivals)])
    evidence = context.of_latest("widths", checked.fitted, lambda: WidthsEvidence(context, checked.fitted))
    for none_less in (True, False) if wider and rivals and alike else (wider,):
        if rivals and evidence.promises(none_less) < RULES.near * least:
            continue
        found = evidence.best(none_less)
        if found.gain < least:
            continue
        # Rivals may have gone since the same was asked of the same fit, but held-out data say what they said.
        name = f"widened, none less: {none_less}"
        after, log_bayes_factor = context.of_latest(
            name, checked.fitted, partial(_widened, context, checked, found, none_less)
        )
        if after is not None:
            return after, log_bayes_factor, none_less
    return checked, 0.0, wider


def _widened(
    context: FitContext, checked: Checked, found: WidthsFound, none_less: bool
) -> tuple[Checked | None, float]:
    """Return the fit with widths that were found and their log Bayes factor; no fit where held-out data refuse it."""
    speaks = context.grid.is_world_root
    say(f"  widths of the beam's prior: {describe(found.widths)} (ln BF {found.log_bayes_factor:.4g})", speaks)
    try:
        fitted, found = adapted(context, checked.fitted, found, fit_patiently, none_less)
        after = check(context, fitted)
    except (BrokenOff, InputError) as why:  # with the widths as they were all has been solved, and stands
        say(f"    refused: {why}", speaks)
        return None, 0.0
    one, two = compared(context, checked, after)
    gain = gain_of(one.score, two.score)
    numbers = f"held-out chi^2 {after.score.chi2:.4g}, rms {after.numbers.of_all['rms']:.4g} Jy, ln density"
    told = f"{numbers} changes by {gain:.4g}"
    is_worse = gain < -RULES.no_worse
    say(f"    {f'refused: {told}' if is_worse else told}", speaks)
    return None if is_worse else after, found.log_bayes_factor


def describe(widths: PriorWidths | None) -> str:
    """Say in words which widths a prior has; all of their numbers are in ``amended.toml``."""
    if widths is None:
        return "those that are stated"
    said = f"{100 * widths.fraction:.3g}% of the model's coefficients"
    if widths.amplitude:
        said += f", beside {100 * widths.amplitude:.3g}% of the largest at low orders"
    if widths.azimuthal:
        said += f", times {min(widths.azimuthal):.3g} to {max(widths.azimuthal):.3g} by azimuthal order"
    return said
