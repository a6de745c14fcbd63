"""What is wrong with data, in words, and what of a job mends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.words import capital, from_to

QUARTER = 0.25
"""Of an integration, before and after the centre of one that is named: no other's is so near."""


@dataclass(frozen=True)
class Finding:
    """Something about the data that no effect describes, or that nothing is known of.

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
    flux_scale : tuple of float
        To multiply the data by: once, or of each channel.
    is_fault : bool
        Whether something is wrong; if not, it is only that this could not be looked for.
    convention : str
        Name of the convention that all data follow instead, where nothing should be fitted to them.
    """

    what: str
    where: str
    why: str
    remedy: str
    antennas: tuple[int, ...] = ()
    baselines: tuple[tuple[int, int], ...] = ()
    times: tuple[tuple[float, float], ...] = ()
    flux_scale: tuple[float, ...] = (1.0,)
    is_fault: bool = True
    convention: str = ""

    @property
    def line(self) -> str:
        """All of it in a line."""
        return f"{capital(self.what)} ({self.where}): {self.why}. Remedy: {self.remedy}."

    @classmethod
    def of_record(cls, record: Mapping[str, object]) -> Finding:
        """Return the words that `record` returned, empty where one is missing."""
        what, where, why, remedy = (str(record.get(key) or "") for key in ("what", "where", "why", "remedy"))
        return cls(what, where, why, remedy)

    def record(self) -> dict[str, str]:
        """Return the words by name, as ``loop.json`` has them."""
        return {"what": self.what, "where": self.where, "why": self.why, "remedy": self.remedy}


def antenna_words(number: int) -> tuple[str, str]:
    """Return the name of an antenna, and the key of a job that leaves it out."""
    return f"antenna {number}", f"exclude_antennas = [{number}] in [data]"


def baseline_words(one: int, two: int) -> tuple[str, str]:
    """Return the name of a baseline of two antennas, and the key of a job that takes it as flagged."""
    return f"baseline {one}-{two}", f"exclude_baselines = [[{one}, {two}]] in [data]"


def integration_words(jds: FloatArray, seconds: FloatArray) -> tuple[str, str, tuple[float, float]]:
    """Return the name of an integration, the key of a job that takes it as flagged, and the Julian dates in that.

    Of several that follow each other, (n,), those of all.
    """
    half = QUARTER * seconds / 86400
    span = round(float((jds - half)[0]), 7), round(float((jds + half)[-1]), 7)
    name = from_to(f"{jds[0]:.6f}", f"{jds[-1]:.6f}")
    return f"JD {name}", f"exclude_times = [[{span[0]:.7f}, {span[1]:.7f}]] in [data]", span


def mended_job(job: Job, findings: Sequence[Finding]) -> Job:
    """Return the job with what the findings leave out, and with their flux scale."""
    data = job.data
    scale = np.array(data.flux_scale)
    for one in findings:
        scale = scale * one.flux_scale
    changes = {
        "exclude_antennas": (*data.exclude_antennas, *(ant for one in findings for ant in one.antennas)),
        "exclude_baselines": (*data.exclude_baselines, *(pair for one in findings for pair in one.baselines)),
        "exclude_times": (*data.exclude_times, *(span for one in findings for span in one.times)),
        "flux_scale": tuple(scale.tolist()),
    }
    return job.model_copy(update={"data": data.model_copy(update=changes)})
