"""What is told of a command."""

from __future__ import annotations

from dataclasses import dataclass

from hydrabeam_mpi.planning.shares import Partition


@dataclass(frozen=True)
class Forecast:
    """What a command takes.

    Attributes
    ----------
    command : str
    ranks : int
    phases_s : dict of str to float
        Seconds by phase.
    memory_bytes, sent_bytes : int
        Of the rank that needs, or sends, most. Memory of a loop is that until all effects have been weighed once.
    file_bytes : int
        Of what is written, simulated data included.
    partition : Partition
    available_bytes : int
        Of a rank on machines like this one; a command that needs more does not begin.
    round_s : float
        Seconds of each effect that a loop finds, those that were taken to be found counted in ``phases_s``.
    further_bytes : int
        Of what a loop finds, besides ``memory_bytes``: at most for each batch of further functions of the beam, and
        for the first effect that changes the sky.
    anew_s : float
        Seconds of a loop over one channel in which all effects are weighed once more, where the prior gets other widths
        at the end; in no other number.
    """

    command: str
    ranks: int
    phases_s: dict[str, float]
    memory_bytes: int
    sent_bytes: int
    file_bytes: int
    partition: Partition
    available_bytes: int
    round_s: float = 0.0
    further_bytes: int = 0
    anew_s: float = 0.0

    @property
    def wall_s(self) -> float:
        """Seconds from start to end."""
        return sum(self.phases_s.values())

    @property
    def fits(self) -> bool:
        """Whether a rank has the memory that it needs."""
        return self.memory_bytes <= self.available_bytes
