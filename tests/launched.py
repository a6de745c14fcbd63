"""Programs that tests start, and what mpiexec makes of signals to them."""

from __future__ import annotations

import os

import pytest
from mpi4py import MPI


def environment(**changes: str) -> dict[str, str]:
    """Return the environment for a program, with changes.

    Python's, not the C library's, to which MPI_Init may have added what is this process's own.
    """
    return {**os.environ, **changes}


IS_PASSED_ON = MPI.get_vendor()[0] != "Open MPI"
"""Whether mpiexec passes signals on to its ranks and waits for them.

That of Open MPI ends them within a second, without what they say then, and with a status of its own.
"""

passed_on = pytest.mark.skipif(not IS_PASSED_ON, reason="Open MPI's mpiexec does not pass signals on")
