"""A plan in words: a table on the console, or JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hydrabeam_mpi.planning.network import Network
from hydrabeam_mpi.planning.told import Forecast
from hydrabeam_mpi.words import counted, duration, size, text_table

HEADINGS = ("command", "ranks", "wall time", "memory/rank", "sent/rank", "files", "groups x ranks", "rows of a rank")


def as_text(forecasts: Sequence[Forecast], assumed: Sequence[str]) -> str:
    """Return a table, a line a forecast, and beneath it what was assumed."""
    lines = [HEADINGS, *map(_cells, forecasts)]
    of_loops = map(_of_loop, (one for one in forecasts if one.command == "loop"))
    too_large = map(_too_large, (one for one in forecasts if not one.fits))
    return "\n".join([text_table(lines), "", *too_large, *of_loops, *assumed]) + "\n"


def as_table(forecasts: Sequence[Forecast], assumed: Sequence[str]) -> dict[str, Any]:
    """Return the same for JSON: numbers in seconds and bytes."""
    return {
        "forecasts": [
            {
                "command": one.command,
                "ranks": one.ranks,
                "wall_s": one.wall_s,
                "phases_s": one.phases_s,
                "memory_bytes": one.memory_bytes,
                "available_bytes": one.available_bytes,
                "fits": one.fits,
                "sent_bytes": one.sent_bytes,
                "file_bytes": one.file_bytes,
                "partition": vars(one.partition),
            }
            | (_of_rounds(one) if one.command == "loop" else {})
            for one in forecasts
        ],
        "assumed": list(assumed),
    }


def assumptions(network: Network, found: int | None) -> list[str]:
    """Say what a plan assumes; ``found`` effects that a loop finds, None where there is no loop."""
    how = "measured between these ranks" if network.measured else "assumed; start under mpiexec to measure them"
    lines = [
        f"messages: {network.alpha * 1e6:.3g} us and {1e-9 / max(network.beta, 1e-15):.3g} GB/s, {how}.",
        "steps: timed on a few rows of this job with made-up data, on this machine as busy as it is now.",
    ]
    if found is not None:
        which = f"{found} effect{'s' * (found != 1)}"
        lines.insert(0, f"loop: how many rounds it takes is not known before; the table takes {which} to be found.")
    return lines


def _of_rounds(one: Forecast) -> dict[str, float]:
    return {"round_s": one.round_s, "anew_s": one.anew_s, "further_bytes": one.further_bytes}


def _too_large(one: Forecast) -> str:
    """Say that a command would not begin."""
    return (
        f"{one.command} on {counted(one.ranks, 'rank')} DOES NOT FIT machines like this one: it needs "
        f"{size(one.memory_bytes)} a rank, and a rank has {size(one.available_bytes)}."
    )


def _of_loop(one: Forecast) -> str:
    """Tell what is certain of a loop from what each effect takes that it finds."""
    anew = f", and {duration(one.anew_s)} where the prior gets other widths in the end" if one.anew_s else ""
    certain = one.wall_s - one.phases_s.get("rounds", 0.0)
    return (
        f"loop on {counted(one.ranks, 'rank')}: {duration(certain)} whatever is found (checks, first fit, "
        f"all effects weighed once, widths of the prior, result), and about {duration(one.round_s)} per effect found "
        f"or batch of further modes{anew}; {size(one.memory_bytes)} a rank, and up to {size(one.further_bytes)} more "
        "for each such batch, and for the first effect that changes the sky."
    )


def _cells(one: Forecast) -> tuple[str, ...]:
    parts = one.partition
    uneven = f", +{parts.imbalance:.0%}" if parts.imbalance >= 0.005 else ""
    return (
        one.command,
        str(one.ranks),
        duration(one.wall_s),
        size(one.memory_bytes),
        size(one.sent_bytes),
        size(one.file_bytes),
        f"{parts.groups} x {parts.ranks_per_group}",
        f"{parts.channels} ch x {parts.times} times x {parts.baseline_groups} bls{uneven}",
    )
