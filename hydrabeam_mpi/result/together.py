"""What stands beside the results of several polarisations that were inferred together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.io.posterior_file import PosteriorFile
from hydrabeam_mpi.io.together import POLARIZATIONS
from hydrabeam_mpi.result.output import write_job_and_provenance, write_json

OF_THE_RUN = ("name", "ranks", "threads_per_rank", "wall_s", "phases_s", "peak_rss_mb")
"""What a summary says of the whole run."""
HEADLINES = (
    "n_data",
    "n_modes",
    "posterior_std_median",
    "condition_number",
    "beam_std_median",
    "beam_update_max",
    "beam_error_max",
    "heldout_chi2_predictive",
    "heldout_chi2_noise_only",
    "heldout_explained",
    "log_evidence",
)
"""What is told of each polarisation, as far as it is known: of the first channel, as at the top of its summary."""


def summarise_together(summaries: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return what ``summary.json`` says beside the results, given theirs by polarisation."""
    last = list(summaries.values())[-1]
    return {
        **{name: last[name] for name in OF_THE_RUN if name in last},
        POLARIZATIONS: {
            pol: {name: told[name] for name in HEADLINES if name in told} for pol, told in summaries.items()
        },
        "warnings": [f"{pol}: {line}" for pol, told in summaries.items() for line in told["warnings"]],
    }


def write_together(folder: Path, job: Job, contents: Sequence[PosteriorFile], summary: dict[str, Any]) -> None:
    """Write summary, job and provenance of the whole run."""
    about = dict(contents[0].provenance)
    del about["integrations"]
    write_json(folder / "summary.json", summary)
    write_job_and_provenance(folder, job, {**about, "job": job.model_dump(mode="json", exclude_none=True)})
