"""Beams at many points: from the table that a beam of coefficients has, see `bases.polar_table`."""

from __future__ import annotations

from functools import partial

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.model.bases.polar_table import PolarTable
from hydrabeam_mpi.model.rime import Beam


def power_of(beam: Beam, za: FloatArray, az: FloatArray) -> FloatArray:
    """Return the real part of a beam at many points, (Npoints,); from its table, where it has one, to the horizon."""
    table = table_of(beam)
    if table is not None:
        return table(np.minimum(za, np.pi / 2), az)
    return np.asarray(beam(za, az)).real


def from_table(beam: Beam) -> Beam:
    """Return a beam as its `PolarTable` gives it; the beam itself where it has none or is complex."""
    is_real = getattr(getattr(beam, "info", None), "is_copol", False)
    return partial(power_of, beam) if is_real and table_of(beam) is not None else beam


def table_of(beam: Beam) -> PolarTable | None:
    """Return a beam's table, by which it and its slopes are cheap at many points; None where it has none."""
    table: PolarTable | None = getattr(beam, "table", None)
    return table
