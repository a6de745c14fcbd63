"""The whole search: rounds until nothing more is found, and once more where something was taken back then."""

from __future__ import annotations

from dataclasses import replace

from hydrabeam_mpi.loop.selection.for_prediction import keep_for_prediction
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.prior_widths import adapt
from hydrabeam_mpi.loop.selection.rounds import Search, run_rounds
from hydrabeam_mpi.terminal.progress import say


def run_search(search: Search) -> None:
    """Do as `run_rounds`, and once more without the effects that are taken back at its end.

    What was not so had stood for something, which others may explain now that it is gone. It would be found again, so
    that it is not offered any more; what is taken back at the second end stays so. All rounds together are as many as
    the job allows. A history that was kept goes on in the search that it was kept in.

    What is not claimed at the very end, but predicts, stays in the model: see `keep_for_prediction`. The last fit has
    the widths of the beam's prior that the data want; what is claimed is that of the one before.

    Collective: all ranks of the grid.
    """
    _run_twice(search)
    history = search.history
    with search.clock.time("prior"):
        found = adapt(search.context, history.last, len(history.rounds), wider=False)
    if found is not None:
        history.claimed = history.claimed or history.last
        history.adapt(found)


def _run_twice(search: Search) -> None:
    """Do what `run_search` does with the beam as free as is stated, or freer. Collective: all ranks of the grid."""
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
    with search.clock.time("trials"):
        keep_for_prediction(search.context, search.history)


def given_up(history: History) -> list[tuple[str, str | None]]:
    """Return kinds and laws of effects that were taken back when nothing more was found, each once."""
    return list(dict.fromkeys(one.candidate.name for one in history.rounds if one.given_up))
