"""How a loop went: its fits, its rounds, and what was tried."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.prior_widths import Adapted


@dataclass
class History:
    """How the loop went.

    Attributes
    ----------
    first, last : Checked
        Before the first and after the last round.
    rounds : list of Round
    tried : list of (Candidate, str)
        Candidates that had the evidence but were refused by the held-out data, with the reason.
    ranking : tuple of Candidate
        Of the last search, in which nothing more was found.
    control : Round, optional
        Control model that explains the data better than all that was found since; not added.
    control_since : int
        How many rounds there were before it.
    claimed : Checked, optional
        Fit of what is claimed alone, where the last one has more for prediction; see `selection.for_prediction`.
    adapted : list of Adapted
        What was decided of the widths of the beam's prior.
    """

    first: Checked
    last: Checked
    rounds: list[Round] = field(default_factory=list)
    tried: list[tuple[Candidate, str]] = field(default_factory=list)
    ranking: tuple[Candidate, ...] = ()
    control: Round | None = None
    control_since: int = 0
    claimed: Checked | None = None
    adapted: list[Adapted] = field(default_factory=list)

    @property
    def n_given(self) -> int:
        """How many changes of the weights the job itself has in the model."""
        return len(self.first.fitted.values.reweighted)

    def add(self, found: Round, places: Mapping[int, int | None]) -> None:
        """Add a round, by which effects are at other ``places`` of the model than before, or taken back (None)."""
        self.rounds = [
            one if one.place is None else replace(one, place=places[one.place]) for one in (*self.rounds, found)
        ]
        self.rounds = [_as_in_model(one, found.after.fitted) for one in self.rounds]
        self.last = found.after

    def tell_again(self, found: Mapping[str, WeightsFound]) -> None:
        """Tell changes of the weights, by kind, as they have been ``found`` since."""
        for number, one in enumerate(self.rounds):
            if one.candidate.kind in found and one.candidate.weights is not None:
                weights = found[one.candidate.kind]
                candidate = replace(one.candidate, weights=weights, log_bayes_factor=weights.fit.log_bayes_factor)
                self.rounds[number] = replace(one, candidate=candidate)

    def adapt(self, adapted: Adapted) -> None:
        """Go on from the last fit with other widths of the beam's prior."""
        self.last = adapted.after
        self.adapted.append(adapted)
        if self.rounds:
            self.rounds[-1] = replace(self.rounds[-1], after=self.last)
        else:
            self.first = self.last

    def compare(self, control: Round | None) -> None:
        """Take note of a control model of the last search, or leave out one that all that was found since surpasses.

        The last is the one that counts: an earlier one may have been fitted with other widths of the beam's prior.
        """
        if control is not None:
            self.control, self.control_since = control, len(self.rounds) - (control.before is not self.last)
        if self.control is None:
            return
        since = self.rounds[self.control_since :]
        evidence = sum(one.candidate.log_bayes_factor for one in since if not one.revoked)
        ahead = self.control.candidate.log_bayes_factor - evidence
        if not ahead + self.control.after.score.log_density - self.last.score.log_density > 0:
            self.control = None


def _as_in_model(one: Round, last: Fitted) -> Round:
    """Return a round with its effect as that is in the model now: sources that varied may have been found constant."""
    if one.place is None or one.candidate.finding is None:
        return one
    effect = last.values.active[one.place].effect
    if effect.law == one.candidate.law:
        return one
    found = replace(one.candidate.finding, effect=effect)
    return replace(one, candidate=replace(one.candidate, title=effect.title, finding=found))
