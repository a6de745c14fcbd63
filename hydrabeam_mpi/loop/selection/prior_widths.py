"""How wide the beam's prior is, is no finding, but the data decide it as they decide what is one: by the evidence.

Effects are looked for twice. At first the beam is as free as the job states, or freer where the data want that: no
width gets less than the stated one. Then the prior has the widths that the data want, where held-out data agree, and
what a beam that was too free had taken up may be found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.prior_widths import WidthsEvidence, adapted, is_adaptable
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked
from hydrabeam_mpi.loop.selection.beyond_basis import with_functions_beyond
from hydrabeam_mpi.loop.selection.folds import compared
from hydrabeam_mpi.loop.selection.heldout_score import gain_of
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.terminal.progress import say


@dataclass(frozen=True)
class Adapted:
    """Fits before and after the widths of the beam's prior were adapted.

    ``log_bayes_factor`` is that of the new ones beside the stated ones, ``n_rounds`` how many rounds there were before.
    ``wider`` says that none could get less than the stated one; ``n_beyond`` is how many functions beyond its basis the
    beam got as well.
    """

    before: Checked
    after: Checked
    log_bayes_factor: float
    n_rounds: int
    wider: bool
    n_beyond: int = 0

    @property
    def widths(self) -> PriorWidths | None:
        """The new ones; None where they are the stated ones."""
        return self.after.fitted.values.prior_widths


def adapt(
    context: FitContext,
    checked: Checked,
    n_rounds: int,
    wider: bool,
    rivals: Sequence[Candidate] = (),
    beyond: Sequence[Effect] = (),
) -> Adapted | None:
    """Give the beam's prior the widths that have the most evidence; None where it has them, or where a rival has more.

    A beam that is further from its model than was stated is told from an effect that it takes up as effects are told
    from each other. Held-out data must not be predicted worse. With ``wider`` no width gets less than the stated one.
    What of the effects ``beyond`` no beam in the basis can follow is added to it then. Collective: all ranks of the
    grid.
    """
    job, speaks = context.problem.job, context.grid.is_world_root
    if job.prior.widths == "stated" or not is_adaptable(context):
        return None
    least = max([job.loop.min_log_bayes_factor, *(one.log_bayes_factor for one in rivals if not one.is_control)])
    evidence = WidthsEvidence(context, checked.fitted)
    if rivals and evidence.promises(wider) < least:
        return None
    found = evidence.best(wider)
    if found.gain < least:
        return None
    say(f"  widths of the beam's prior: {describe(found.widths)} (ln BF {found.log_bayes_factor:.4g})", speaks)
    fitted, found = adapted(context, checked.fitted, found, fit_patiently, wider)
    after = check(context, fitted)
    one, two = compared(context, checked, after)
    gain = gain_of(one.score, two.score)
    numbers = f"held-out chi^2 {after.score.chi2:.4g}, rms {after.numbers.of_all['rms']:.4g} Jy, ln density"
    told = f"{numbers} changes by {gain:.4g}"
    say(f"    {f'refused: {told}' if gain < 0 else told}", speaks)
    if gain < 0:
        return None
    after, n_beyond = with_functions_beyond(context, after, beyond)
    return Adapted(checked, after, found.log_bayes_factor, n_rounds, wider, n_beyond)


def describe(widths: PriorWidths | None) -> str:
    """Say in words which widths a prior has."""
    if widths is None:
        return "those that are stated"
    beside = " (of the largest of each and those at adjacent radial orders)" if widths.neighbours else ""
    return f"{widths.fraction:.3g} of the model's coefficients{beside}{_smooth_part(widths)}{_by_order(widths)}"


def _smooth_part(widths: PriorWidths) -> str:
    if not widths.amplitude:
        return ""
    radial, azimuthal = np.exp(widths.decay)
    return (
        f", and beside that {widths.amplitude:.3g} of the largest at the lowest orders, less by a factor of "
        f"{radial:.3g} for each radial and {azimuthal:.3g} for each azimuthal order"
    )


def _by_order(widths: PriorWidths) -> str:
    if not widths.azimuthal:
        return ""
    return f", times factors of {min(widths.azimuthal):.3g} to {max(widths.azimuthal):.3g} by azimuthal order"
