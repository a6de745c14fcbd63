"""The whole search: rounds until nothing more is found, and once more where something was taken back then."""

from __future__ import annotations

from dataclasses import replace

from hydrabeam_mpi.loop.selection.for_prediction import keep_for_prediction
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.known_beforehand import may_be_off_alike
from hydrabeam_mpi.loop.selection.prior_widths import adapt
from hydrabeam_mpi.loop.selection.rounds import Search, run_rounds
from hydrabeam_mpi.loop.selection.weighing import next_of
from hydrabeam_mpi.terminal.progress import say


def run_search(search: Search) -> None:
    """Do as `run_rounds`, and once more without the effects that are taken back at its end.

    What was not so had stood for something, which others may explain now that it is gone. It would be found again, so
    that it is not offered any more; what is taken back at the second end stays so. All rounds together are as many as
    the job allows. A history that was kept goes on in the search that it was kept in.

    All of that is done with a beam as free as the job states, or freer, and once more with the widths of its prior that
    the data want: a beam that is freer than need be takes up what is faint. The beams of several channels may be off
    alike, by a tilt say, which a prior of independent ones takes for as many coincidences. The narrower that is, the
    more an effect seems to explain that all channels share: where nothing in the model lets them be off alike these
    widths are for prediction alone, and what is claimed, and the verdict, are of the fit before.

    What is not claimed at the very end, but predicts, stays in the model: see `keep_for_prediction`.

    Collective: all ranks of the grid.
    """
    context, history = search.context, search.history
    alike = may_be_off_alike(context, history.last.fitted.values)
    _run_twice(search)
    if alike and _adapted(search):
        _run_twice(search)
    if given_up(history):
        with search.clock.time("trials"):
            keep_for_prediction(context, history)
    claimed = history.claimed or history.last
    if not alike and _adapted(search):
        history.claimed = claimed


def _adapted(search: Search) -> bool:
    """Give the beam's prior the widths that the data want; whether these are new. Collective: all ranks of the grid."""
    context, history = search.context, search.history
    effects = next_of(context, search.effects, history.last.fitted.values)
    with search.clock.time("prior"):
        found = adapt(context, history.last, len(history.rounds), wider=False, effects=effects)
    if found is not None:
        history.adapt(found)
    return found is not None


def _run_twice(search: Search) -> None:
    """Run rounds, and once more without what they take back. Collective: all ranks of the grid."""
    if not given_up(search.history):
        run_rounds(search)
        if not given_up(search.history):
            return
        search.save()
    say("once more, without what was taken back", search.context.grid.is_world_root)
    gone = given_up(search.history)
    effects = [one for one in search.effects if (one.kind, one.law) not in gone]
    changes = [one for one in search.changes if (one.kind, None) not in gone]
    run_rounds(replace(search, effects=effects, changes=changes))


def given_up(history: History) -> list[tuple[str, str | None]]:
    """Return kinds and laws of effects that were taken back when nothing more was found, each once."""
    return list(dict.fromkeys(one.candidate.name for one in history.rounds if one.given_up))
