"""What is wrong with data, in words, and what of a job mends it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hydrabeam_mpi.config import Job


@dataclass(frozen=True)
class Finding:
    """Something about the data that no effect describes.

    Attributes
    ----------
    what, where, why, remedy : str
        In words: what it is, of which antenna, time or channel, what shows it, and what a user can do.
    antennas : tuple of int
        To leave out.
    baselines : tuple of (int, int)
        To take as flagged.
    times : tuple of (float, float)
        To take as flagged, Julian dates from and to.
    flux_scale : float
        To multiply the data by.
    """

    what: str
    where: str
    why: str
    remedy: str
    antennas: tuple[int, ...] = ()
    baselines: tuple[tuple[int, int], ...] = ()
    times: tuple[tuple[float, float], ...] = ()
    flux_scale: float = 1.0

    @property
    def line(self) -> str:
        """All of it in a line."""
        return f"{self.what[:1].upper()}{self.what[1:]} ({self.where}): {self.why}. Remedy: {self.remedy}."

    def record(self) -> dict[str, str]:
        """Return the words by name, as ``loop.json`` has them."""
        return {"what": self.what, "where": self.where, "why": self.why, "remedy": self.remedy}


def mended_job(job: Job, findings: Sequence[Finding]) -> Job:
    """Return the job with what the findings leave out, and with their flux scale."""
    data = job.data
    scale = data.flux_scale
    for one in findings:
        scale *= one.flux_scale
    changes = {
        "exclude_antennas": (*data.exclude_antennas, *(ant for one in findings for ant in one.antennas)),
        "exclude_baselines": (*data.exclude_baselines, *(pair for one in findings for pair in one.baselines)),
        "exclude_times": (*data.exclude_times, *(span for one in findings for span in one.times)),
        "flux_scale": scale,
    }
    return job.model_copy(update={"data": data.model_copy(update=changes)})
