"""The layout of `jobs/hera_350`: what the job says of it, and that it can be observed with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyuvdata

from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.simulation.arrays import read_layout

LAYOUT = Path(__file__).parents[2] / "jobs" / "hera_350" / "antennas.csv"


@pytest.mark.parametrize(("first", "n_antennas", "n_unique"), [("HH", 320, 1501), ("H", 350, 8009)])
def test_core_and_outriggers_have_the_baselines_that_the_job_states(first: str, n_antennas: int, n_unique: int) -> None:
    layout = read_layout(LAYOUT)
    places = layout.antpos[[name.startswith(first) for name in layout.names]]
    assert len(places) == n_antennas
    one, other = np.triu_indices(n_antennas, 1)
    assert find_redundant_groups(places[other] - places[one], 0.5, either_sign=True).Ngroups == n_unique


def test_positions_are_those_that_pyuvdata_knows() -> None:
    """To the tenth of a millimetre that the table gives: distances do not depend on the frame."""
    table = Path(pyuvdata.__file__).parent / "data" / "hera_ant_pos.csv"
    ecef = np.loadtxt(table, delimiter=",", skiprows=1, usecols=(2, 3, 4))
    enu = read_layout(LAYOUT).antpos
    np.testing.assert_allclose(*(np.linalg.norm(places - places[0], axis=1) for places in (enu, ecef)), atol=3e-4)
