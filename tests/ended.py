"""Runs under mpiexec that a signal ends."""

from __future__ import annotations

import pytest
from mpi4py import MPI

IS_PASSED_ON = MPI.get_vendor()[0] != "Open MPI"
"""Whether mpiexec passes signals on to its ranks and waits for them.

That of Open MPI ends them within a second, without what they say then, and with a status of its own.
"""

passed_on = pytest.mark.skipif(not IS_PASSED_ON, reason="Open MPI's mpiexec does not pass signals on")
