"""How long the phases of a run take."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class Clock:
    """Wall-clock seconds a phase, as one rank sees them."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def time(self, phase: str) -> Iterator[None]:
        """Add the time that the block takes to ``phase``."""
        start = time.perf_counter()
        yield
        self.seconds[phase] = self.seconds.get(phase, 0.0) + time.perf_counter() - start

    @property
    def inference(self) -> float:
        """Seconds from the data in memory to the posterior mean and covariance (HDBI II, section 4.1)."""
        return self.seconds["design"] + self.seconds["solve"]
