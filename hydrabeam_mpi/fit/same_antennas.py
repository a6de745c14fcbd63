"""Whether the antennas of other data are those in which effects were found, rather than others of the same numbers."""

from __future__ import annotations

import re

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.carried_over import CarriedOver
from hydrabeam_mpi.io.inferred import Inferred

OF_ANTENNAS = re.compile(r"\bantenna (\d+)|\bbaseline (\d+)-(\d+)")
"""Names of parameters that are of single antennas or baselines."""


def check_places(result: Inferred, carried: CarriedOver, observation: Observation, tol: float) -> None:
    """Make sure that what carries over of single antennas and baselines is of the same antennas.

    ``tol`` is in metres.

    Raises
    ------
    InputError
        If some of these stand elsewhere.
    """
    moved = result.moved_antennas(observation, tol)
    words = " ".join(name for one in carried.carried for name in one["parameters"])
    named = {int(number) for found in OF_ANTENNAS.findall(words) for number in found if number}
    if others := sorted(named & moved.keys()):
        numbers, far = ", ".join(map(str, others)), max(moved[one] for one in others)
        which = f"antenna {numbers} stands" if len(others) == 1 else f"antennas {numbers} stand"
        raise InputError(
            f"{which} up to {far:.3g} m elsewhere than in the result's own data, in which effects of such were found",
            field="[data] files",
            remedy=f"leave them out (exclude_antennas = [{numbers}] in [data]), or give them numbers of their own",
        )
