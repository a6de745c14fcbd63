"""Beams from their tables are the beams themselves."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
from hydrabeam_mpi.model.tabulated import from_table
from hydrabeam_mpi.random import generator


def test_a_real_beam_is_that_of_its_table() -> None:
    basis, rng = FourierBessel.full(20, 4), generator(1, "from a table")
    coeffs = rng.standard_normal(basis.n_modes) / (1 + np.arange(basis.n_modes))
    beams = {pol: CoefficientBeam(basis, coeffs, BeamInfo("drawn", 1e8, pol)) for pol in ("ee", "en")}
    za, az = rng.uniform(0, np.pi / 2, 500), rng.uniform(0, 2 * np.pi, 500)
    exact = beams["ee"](za, az)
    # Of a beam with as much in its highest modes as none has; these are off by a millionth of themselves.
    np.testing.assert_allclose(from_table(beams["ee"])(za, az), exact, rtol=0, atol=1e-6 * np.abs(exact).max())
    assert from_table(beams["ee"]) is not beams["ee"]
    # A table has real parts alone.
    assert from_table(beams["en"]) is beams["en"]
