import re

import numpy as np
import pytest
from astropy.time import Time
from astropy.utils import iers

from hydrabeam_mpi.model.earth_orientation import ARCSEC_PER_SECOND, beyond_table


def table_end():
    return iers.earth_orientation_table.get()["MJD"][-1].value + 2400000.5


def misplaced(sentence):
    return [float(number) for number in re.search(r"about (\S+) arcsec, by (\S+) at most\.", sentence).groups()]


def test_dates_within_the_table_need_no_word():
    assert beyond_table(np.array([table_end() - 700, table_end() - 1e-3])) is None


@pytest.mark.parametrize(
    ("days", "words"), [(3, "3.0 days"), (100, "100.0 days"), (730.5, "2.0 years"), (36525, "100.0 years")]
)
def test_the_last_date_counts(days, words):
    sentence = beyond_table(np.array([table_end() + days, table_end() - 10]))
    assert f"go on {words} beyond the end ({Time(table_end(), format='jd').strftime('%Y-%m-%d')})" in sentence
    assert "newer astropy-iers-data" in sentence


def test_the_cost_grows_with_time_and_begins_with_the_pole():
    costs = np.array([misplaced(beyond_table(np.array([table_end() + days]))) for days in (1, 30, 365, 3650, 36500)])
    assert np.all(np.diff(costs, axis=0) > 0)
    assert np.all(costs[:, 1] > costs[:, 0])
    # The pole wanders by a few tenths of an arcsecond, and a day is up to 4 ms too long.
    assert 0.1 < costs[0, 0] < costs[0, 1] < 0.6 + 4e-3 * ARCSEC_PER_SECOND


def test_the_cost_covers_what_a_table_cut_short_lacks():
    """Cut the table two years before the end of what is measured: so much is the sky really off at that end."""
    table = iers.earth_orientation_table.get()
    measured = table[: table.meta["predictive_index"]]
    jump = np.diff(measured["UT1_UTC"][-731:].to_value("s"))
    off = abs(np.sum(jump - jump.round())) * ARCSEC_PER_SECOND
    usual, most = misplaced(beyond_table(np.array([table_end() + 730])))
    assert off < most
    assert usual < most
