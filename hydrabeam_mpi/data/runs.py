"""Numbers that follow each other, such as those of channels and integrations."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import IntArray


def runs_of(numbers: IntArray) -> list[IntArray]:
    """Return the runs of ascending numbers, (n,), that follow each other without a gap; none where there are none."""
    return np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if len(numbers) else []
