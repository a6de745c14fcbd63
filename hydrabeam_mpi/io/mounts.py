"""Whether antennas stand still, as the model takes their beams: what files say of their mounts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import UVHeader

TRACKING = ("alt-az", "alt-az+nasmyth-r", "alt-az+nasmyth-l", "equatorial", "x-y", "orbiting")
"""Mounts of pyuvdata by which beams move over the ground; "fixed" and "other" are none."""
STEERED = "phased"
UNSET = "alt-az"
"""Number 0 in uvfits, as of what nobody has set."""


def check_mounts(headers: Sequence[UVHeader], antennas: IntArray) -> None:
    """Refuse antennas that follow the sky, where somebody has said so.

    Programs state a mount where nobody has: uvfits and measurement sets have alt-az dishes by default, as have uvh5
    files made from them, and those of LOFAR have dipoles on X-Y mounts.

    Parameters
    ----------
    headers : sequence of UVHeader
    antennas : ndarray of int, (Nants,)
        Numbers of those in use.

    Raises
    ------
    InputError
        If a file says that one does.
    """
    for header, number, mount in _mounts(headers, antennas):
        if mount in TRACKING and not _may_be_unset(header, mount):
            raise InputError(
                f'antenna {number} is on a mount that follows the sky ("{mount}"), and beams of the model stand still',
                file=header.path,
                field="mount_type",
                remedy='if it stood still, set UVData.telescope.mount_type to "fixed" and write the file again',
            )


def doubt_about_mounts(headers: Sequence[UVHeader], antennas: IntArray) -> str | None:
    """Say that antennas may not stand still, with the parameters of `check_mounts`."""
    for header, _, mount in _mounts(headers, antennas):
        if mount == STEERED:
            return (
                'The files say that antennas are steered electronically (mount_type is "phased"): the model takes '
                "beams that stand still, so all the data must be of one pointing."
            )
        if _may_be_unset(header, mount):
            return (
                f'The files say that antennas are on mounts that follow the sky ("{mount}"), as uvfits and '
                "measurement sets, and what is made from them, do also where nobody said so. The model takes beams "
                "that stand still."
            )
    return None


def _mounts(headers: Sequence[UVHeader], antennas: IntArray) -> Iterator[tuple[UVHeader, int, str]]:
    """Yield files, the numbers of their antennas that are in use, and the mounts of these."""
    used = set(antennas.tolist())
    for header in headers:
        for number, mount in zip(header.antenna_numbers.tolist(), header.mounts, strict=False):
            if number in used:
                yield header, number, mount


def _may_be_unset(header: UVHeader, mount: str) -> bool:
    return mount in TRACKING and (header.kind != "uvh5" or mount == UNSET)
