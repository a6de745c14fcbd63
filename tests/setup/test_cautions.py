"""Which channels have no data."""

from __future__ import annotations

from hydrabeam_mpi.setup.cautions import cautions_of_flags

GOOD = {"freq_hz": 131e6, "n_data": 42, "heldout_n": 40.0}
EMPTY = {"freq_hz": 131.1e6, "n_data": 0}


def test_channels_without_data_are_named() -> None:
    assert cautions_of_flags([GOOD, GOOD], holds_out=True) == ()
    fitted, held_out = cautions_of_flags([GOOD, EMPTY, EMPTY | {"freq_hz": 132e6}], holds_out=True)
    assert fitted.startswith("At 131.1, 132 MHz all data to fit are flagged")
    assert held_out.startswith("At 131.1, 132 MHz all held-out data are flagged")


def test_where_nothing_was_to_be_held_out_nothing_lacks() -> None:
    assert cautions_of_flags([{"freq_hz": 131e6, "n_data": 42}], holds_out=False) == ()
