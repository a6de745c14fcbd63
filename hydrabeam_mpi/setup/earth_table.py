"""The table of the Earth's orientation, read once for all ranks."""

from __future__ import annotations

from astropy.utils import iers

from hydrabeam_mpi.mpi import Comm, bcast_object


def share_earth_table(world: Comm) -> None:
    """Have astropy use on all ranks what it reads on rank 0: its text takes each the better part of a second.

    Collective: all ranks of `world`.
    """
    iers.IERS_Auto.iers_table = bcast_object(world, iers.IERS_Auto.open() if world.rank == 0 else None)
