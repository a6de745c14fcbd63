"""The parts of the page that are text: findings, warnings, tables, provenance; each returns HTML."""

from __future__ import annotations

import json
import re
from html import escape
from typing import Any

import tomli_w

from hydrabeam_mpi.report.page.key_numbers import PAPER_HEADING, Kind, format_value, table
from hydrabeam_mpi.report.page.result import Channel, Result
from hydrabeam_mpi.report.page.words import heldout_words, megahertz, remarks

SIGNS = {"chi^2": "χ²", " -> ": " → ", " +- ": " ± "}


def as_html(text: str) -> str:
    """Escape text and set its powers of ten, such as 4.5e-6, and its signs as one writes them by hand."""
    for plain, sign in SIGNS.items():
        text = text.replace(plain, sign)

    def power(match: re.Match[str]) -> str:
        mantissa, exponent = match[1], str(int(match[2])).replace("-", "−")
        return f"{'' if mantissa == '1' else f'{mantissa} × '}10<sup>{exponent}</sup>"

    signed = re.sub(r"(?<![\w.])-(?=\d)", "−", escape(text))
    return re.sub(r"(?<![\w.])(?<![\w.]-)(\d+(?:\.\d+)?)e([+-]?\d+)\b", power, signed)


def finding(channel: Channel) -> str:
    """Tell the held-out residual before and after the inference; empty where nothing was held out."""
    words = heldout_words(channel.numbers)
    return f'<div class="finding"><p>{as_html(words)}</p></div>\n' if words else ""


def warnings(result: Result) -> str:
    """List what a reader must not overlook."""
    said = "".join(f"<li>{as_html(remark)}</li>" for remark in remarks(result))
    return f'<div class="warnings"><p>Read this first</p><ul>{said}</ul></div>\n' if said else ""


def key_numbers(result: Result) -> str:
    """Set the table of key numbers with their meaning, and the paper's where it is the paper's experiment."""
    groups = table(result.numbers, result.name)
    if not groups:
        return ""
    with_paper = any(row.paper for rows in groups.values() for row in rows)
    paper = f"<th>{PAPER_HEADING[0].upper()}{PAPER_HEADING[1:]}</th>" if with_paper else ""
    lines = []
    for group, rows in groups.items():
        lines.append(f'<tr><th colspan="{3 + with_paper}">{escape(group)}</th></tr>')
        for row in rows:
            cell = f"<td>{as_html(row.paper)}</td>" if with_paper else ""
            lines.append(
                f'<tr><td>{as_html(row.what)}</td><td class="value">{as_html(row.value)}</td>{cell}'
                f'<td class="key">{escape(row.key)}</td></tr>'
            )
    note = f" of the first channel, {megahertz(result.channels[0].freq)}" if len(result.channels) > 1 else ""
    head = f'<tr><th>What it is</th><th class="value">Value</th>{paper}<th>Key in summary.json</th></tr>'
    return set_table(f"Key numbers{note}", head, lines)


CHANNEL_COLUMNS: dict[str, tuple[str, Kind]] = {
    "n_data": ("visibilities", "count"),
    "posterior_std_median": ("median std", "number"),
    "condition_number": ("condition number", "number"),
    "beam_error_max": ("largest error", "number"),
    "beam_update_max": ("largest change", "number"),
    "negative_fraction": ("negative", "percent"),
    "heldout_chi2_unperturbed": ("χ² held out over noise, model", "number"),
    "heldout_chi2": ("χ² held out over noise, inferred", "number"),
    "heldout_chi2_predictive": ("χ² held out, predictive", "number"),
}


def channel_table(channels: list[Channel]) -> str:
    """Set the most telling numbers of every channel, one line each."""
    keys = [key for key in CHANNEL_COLUMNS if any(key in channel.numbers for channel in channels)]
    names = "".join(f'<th class="value">{escape(CHANNEL_COLUMNS[key][0])}</th>' for key in keys)
    lines = []
    for channel in channels:
        values = [
            format_value(channel.numbers[key], CHANNEL_COLUMNS[key][1]) if key in channel.numbers else "–"
            for key in keys
        ]
        cells = "".join(f'<td class="value">{as_html(value)}</td>' for value in values)
        lines.append(f'<tr><td class="value">{megahertz(channel.freq)}</td>{cells}</tr>')
    return set_table("", f'<tr><th class="value">frequency</th>{names}</tr>', lines, "channels")


def set_table(title: str, head: str, lines: list[str], kind: str = "keys") -> str:
    """Set a table from its head and its lines, under a heading where there is a title."""
    heading = f"<h2>{escape(title)}</h2>\n" if title else ""
    body = "\n".join(lines)
    return f'{heading}<table class="{kind}">\n<thead>{head}</thead>\n<tbody>\n{body}\n</tbody>\n</table>\n'


def provenance(result: Result) -> str:
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
    inside = "".join(f"<h3>{escape(title)}</h3>\n<pre>{escape(text)}</pre>\n" for title, text in blocks.items() if text)
    return f"<h2>Provenance</h2>\n<details><summary>Versions, checksums, seed and job</summary>\n{inside}</details>\n"


def _lines(entries: dict[str, Any]) -> str:
    return "\n".join(
        f"{key}: {value if isinstance(value, str | int | float) else json.dumps(value)}"
        for key, value in entries.items()
    )
