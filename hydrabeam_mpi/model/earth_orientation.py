"""How far sources are misplaced for dates beyond astropy's table of the Earth's orientation."""

from __future__ import annotations

import numpy as np
from astropy.time import Time
from astropy.utils import iers

from hydrabeam_mpi.data.observation import FloatArray

# The sky turns by so much in a second of UT1.
ARCSEC_PER_SECOND = 15.04


def beyond_table(times: FloatArray) -> str | None:
    """Say how far times lie beyond the table, measured and predicted, and by how much sources are misplaced there.

    Beyond its end astropy keeps UT1 - UTC as it was and takes the mean pole. What that costs is told from the table
    itself: from how far UT1 - UTC, leap seconds apart, has moved in equally long times, and from how far the pole
    has been from its mean.

    Parameters
    ----------
    times : ndarray, (Ntimes,)
        Julian dates.

    Returns
    -------
    str or None
        A sentence, or None where the table holds all times.
    """
    table = iers.earth_orientation_table.get()
    end = float(table["MJD"][-1].value)
    last = Time(np.max(times), format="jd").mjd
    if last <= end:
        return None
    day = Time(end, format="mjd").strftime("%Y-%m-%d")
    usual, most = (f"{float(f'{cost:.2g}'):g}" for cost in _misplaced(table, last - end))
    return (
        f"The data go on {_duration(last - end)} beyond the end ({day}) of the table of the Earth's orientation: "
        f"sources are misplaced by about {usual} arcsec, by {most} at most. "
        "A newer astropy-iers-data has a later table."
    )


def _misplaced(table: iers.IERS, days: float) -> tuple[float, float]:
    """Return by how many arcsec sources are usually and at most misplaced so many days beyond the table."""
    steps = np.diff(table["UT1_UTC"].to_value("s"))
    ut1 = np.cumsum(steps - steps.round())  # leap seconds are steps of one
    # The table has a row a day. Half of it is the longest time that it tells much of.
    lag = int(np.clip(np.ceil(days), 1, len(ut1) // 2))
    moved = np.abs(ut1[lag:] - ut1[:-lag]) * max(days / lag, 1) * ARCSEC_PER_SECOND
    x, y = (table[name].to_value("arcsec") for name in ("PM_x", "PM_y"))
    pole = np.hypot(x - x.mean(), y - y.mean())
    return float(np.median(moved) + np.median(pole)), float(moved.max() + pole.max())


def _duration(days: float) -> str:
    return f"{days:.1f} days" if days < 365 else f"{days / 365.25:.1f} years"
