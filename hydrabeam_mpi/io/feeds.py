"""Which polarisation of a beam file is meant, and whether its header tells the truth about its feeds.

Beam files label feeds x and y and say in the header which of them points East. That header is sometimes
wrong: the circulating Vivaldi beams of HERA say that x points North, while their E-fields show x along
East-West. A co-polarised beam taken from the wrong feed is rotated by 90 degrees, so an E-field file is
checked against its own field, and a job may name the feed that points East.
"""

from __future__ import annotations

import numpy as np
from pyuvdata import UVBeam
from pyuvdata.utils import polnum2str, polstr2num

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError

UNKNOWN = "Where feeds point is not known; x is written as East."
"""What files that have to tell it say of themselves where the data do not."""
# The field is looked at within this zenith angle (radians), where East and North are well defined.
_NEAR_ZENITH = np.deg2rad(15)


def x_orientation(uvbeam: UVBeam, east_feed: str | None) -> str | None:
    """Return where feed x points, "east" or "north": by ``east_feed`` ("x" or "y"), else by the header."""
    if east_feed is None:
        said: str | None = uvbeam.get_x_orientation_from_feeds()
        return said
    if east_feed not in ("x", "y"):
        raise InputError(f"{east_feed!r} is not a feed", field="east_feed", remedy='use "x" or "y"')
    return "east" if east_feed == "x" else "north"


def pol_number(pol: str, orientation: str | None, *, file: str, known: list[int]) -> int:
    """Return the number of polarisation ``pol`` in a file.

    Parameters
    ----------
    pol : str
        As labelled ("xx", "xy", ...) or by direction ("ee", "en", ...).
    orientation : str or None
        Where feed x points.
    file : str
        For the message.
    known : list of int
        Polarisations that the file has.

    Raises
    ------
    InputError
        If the name is unknown, needs an orientation that the file does not have, or is not in the file.
    """
    try:
        number = int(polstr2num(pol, x_orientation=orientation))
    except KeyError:
        if orientation is None and set(pol) <= {"e", "n"}:
            message = f"the file does not say where its feeds point, so {pol!r} has no meaning"
            raise InputError(message, file=file, field="pol", remedy="name the feed: east_feed") from None
        remedy = 'ask for "ee" or "nn"'
        raise InputError(f"unknown polarisation {pol!r}", file=file, field="pol", remedy=remedy) from None
    if number not in known:
        names = ", ".join(polnum2str(known, x_orientation=orientation))
        raise InputError(f"no polarisation {pol!r}", file=file, field="pol", remedy=f"the file has {names}")
    return number


def orientation_from_field(uvbeam: UVBeam, za: FloatArray, az: FloatArray) -> str | None:
    """Return where feed x points by its field near the zenith: "east", "north", or None if it is neither.

    Parameters
    ----------
    uvbeam : pyuvdata.UVBeam
        E-field beam with a feed "x".
    za, az : ndarray, (Npix,)
        Of its pixels, radians.
    """
    feeds = [str(feed).lower() for feed in uvbeam.feed_array]
    near = za < max(_NEAR_ZENITH, 1.01 * float(za.min()))
    if "x" not in feeds:
        return None
    channel = uvbeam.Nfreqs // 2
    recorded = uvbeam.data_array[:, feeds.index("x"), channel].reshape(2, -1)[:, near]
    directions = uvbeam.basis_vector_array.reshape(2, 2, -1)[:, :, near]
    along_az, along_za = np.einsum("ai,aci->ci", recorded, directions)
    horizontal = along_za * np.cos(za[near])
    cos, sin = np.cos(az[near]), np.sin(az[near])
    east = np.nansum(np.abs(horizontal * cos - along_az * sin) ** 2)
    north = np.nansum(np.abs(horizontal * sin + along_az * cos) ** 2)
    # A dipole puts all but a few per cent of its field near the zenith along its axis; 45 degrees is neither.
    if max(east, north) <= 4 * min(east, north):
        return None
    return "east" if east > north else "north"
