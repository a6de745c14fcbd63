"""Which candidates of a scan are weighed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from hydrabeam_mpi.api.preparation import prepare_shared_each
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.joint import read_context
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.job_file import load
from tests.validation.undeclared.generate import GIVEN, generate


def test_a_source_that_the_beam_takes_up_is_weighed(tmp_path: Path) -> None:
    """The flux of a bright one is wrong, and the beam makes up for all but half a per cent of it.

    Of what is left, with the beam as it is, forty of three hundred others explain more.
    """
    generate(41027, tmp_path, "flux_at_transit", "study")
    world = MPI.COMM_SELF
    (problem,) = prepare_shared_each(world, load(world, tmp_path / GIVEN / "job.toml"), None)
    context = read_context(ProcessGrid.split(world, 1), problem, problem, Clock())
    (found,) = attribute(context, refit(context, Values()), [CatalogueFlux()])
    used = np.flatnonzero(found.evidence.prior_var)
    assert [found.effect.parameters(context.setup).names[i] for i in used] == ["source 60: relative flux error"]
    assert found.evidence.absorbed > 0.98
    assert found.evidence.log_bayes_factor > 50
    np.testing.assert_allclose(found.evidence.x[0, used], -0.0875, atol=0.02)
