"""The parts of the page that any result has: the error before and after, key numbers, channels, provenance."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import tomli_w
from markupsafe import Markup

from hydrabeam_mpi.report.page.key_numbers import PAPER_HEADING, Kind, format_value, table
from hydrabeam_mpi.report.page.parts import part, set_table, together, under
from hydrabeam_mpi.report.page.result import Channel, Result
from hydrabeam_mpi.report.page.words import heldout_words, megahertz

ERRORS = {
    "reduced χ² of held-out data, noise alone gives 1": ("heldout_chi2_unperturbed", "heldout_chi2_noise_only"),
    "rms residual of held-out data, Jy": ("heldout_rms_jy_unperturbed", "heldout_rms_jy"),
    "largest error of the beam": ("model_error_max", "beam_error_max"),
}
"""Measures of the error: with the model beam, and with the inferred one."""


def errors_table(channels: list[Channel]) -> Markup:
    """Set the error before and after the inference, the median of channels; nothing where it is unknown."""
    rows = []
    for what, keys in ERRORS.items():
        known = [[one.numbers[key] for key in keys] for one in channels if all(key in one.numbers for key in keys)]
        if known:
            rows.append((what, *(format_value(value) for value in np.median(known, axis=0))))
    name = f"median of {len(channels)} channels" if len(channels) > 1 else ""
    return set_table((name, "model beam", "inferred beam"), rows, (1, 2)) if rows else Markup()


def finding(channel: Channel) -> Markup:
    """Tell the held-out residual before and after the inference; empty where nothing was held out."""
    words = heldout_words(channel.numbers)
    return part("finding", words) if words else Markup()


def key_numbers(result: Result) -> Markup:
    """Set the table of key numbers with their meaning, and the paper's where it is the paper's experiment."""
    groups = table(result.numbers, result.name)
    with_paper = any(row.paper for rows in groups.values() for row in rows)
    rows: list[list[str]] = []
    for group, lines in groups.items():
        rows.append([group])
        for row in lines:
            key = Markup('<span class="key">{}</span>').format(row.key)
            rows.append([row.what, row.value, *([row.paper] if with_paper else []), key])
    paper = [PAPER_HEADING[0].upper() + PAPER_HEADING[1:]] if with_paper else []
    names = ["What it is", "Value", *paper, "Key in summary.json"]
    return set_table(names, rows, (1,), "keys") if rows else Markup()


CHANNEL_COLUMNS: dict[str, tuple[str, Kind]] = {
    "n_data": ("visibilities", "count"),
    "posterior_std_median": ("median std", "number"),
    "condition_number": ("condition number", "number"),
    "beam_error_max": ("largest error", "number"),
    "beam_update_max": ("largest change", "number"),
    "negative_fraction": ("negative", "percent"),
    "heldout_chi2_unperturbed": ("χ² held out over noise, model", "number"),
    "heldout_chi2_noise_only": ("χ² held out over noise, inferred", "number"),
    "heldout_chi2_predictive": ("χ² held out, predictive", "number"),
}


def channel_table(channels: list[Channel]) -> Markup:
    """Set the most telling numbers of every channel, one line each."""
    keys = [key for key in CHANNEL_COLUMNS if any(key in channel.numbers for channel in channels)]
    rows = [
        [
            megahertz(channel.freq),
            *(
                format_value(channel.numbers[key], CHANNEL_COLUMNS[key][1]) if key in channel.numbers else "–"
                for key in keys
            ),
        ]
        for channel in channels
    ]
    names = ["frequency", *(CHANNEL_COLUMNS[key][0] for key in keys)]
    return set_table(names, rows, range(len(names)))


def provenance(result: Result) -> Markup:
    """Fold away where the result comes from: versions, checksums, the resolved job with its seed."""
    about = dict(result.provenance)
    job, versions, checksums = (about.pop(key, {}) for key in ("job", "versions", "sha256"))
    phases = result.numbers.get("phases_s")
    blocks = {
        "Versions": _lines(versions),
        "Run": _lines({"seed": job.get("seed", "–"), **about}),
        "Seconds by phase": _lines({name: f"{value:.3g}" for name, value in phases.items()}) if phases else "",
        "Input files (SHA-256)": _lines(checksums) or "none: the data were simulated in the run",
        "Job, as resolved": tomli_w.dumps(job).strip(),
    }
    inside = together(*(under(title, part("block", text)) for title, text in blocks.items() if text))
    return part("folded", "Versions, checksums, seed and job", inside)


def _lines(entries: dict[str, Any]) -> str:
    return "\n".join(
        f"{key}: {value if isinstance(value, str | int | float) else json.dumps(value)}"
        for key, value in entries.items()
    )
