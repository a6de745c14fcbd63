"""Chains of beams that are off alike: what is drawn of a beam is all of it, and as in the posterior of all channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tomli_w

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.loop.output.amendment import amended_job
from hydrabeam_mpi.sampling.storage.store import ChainStore
from tests.fit.test_common_beam import BASES, THREE, known


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_beams_are_drawn_as_they_are_written(basis: dict[str, object], tmp_path: Path) -> None:
    context, values = known(THREE, tmp_path, basis=basis)
    fitted = refit(context, values)
    job = amended_job(context.problem.job, fitted, context.setup)
    (tmp_path / "amended.toml").write_text(tomli_w.dumps(job.model_dump(mode="json", exclude_none=True)))
    made = ["sample", str(tmp_path / "amended.toml"), "-o", str(tmp_path / "chains"), "--chains", "1"]
    assert main([*made, "--draws", "60"]) == 0
    # It goes on from what was stored.
    assert main([*made, "--draws", "400"]) == 0
    draws = ChainStore.open(tmp_path / "chains").read("beam", 0)
    assert draws.shape == (400, 3, context.problem.basis.n_modes)
    for channel, result in enumerate(channel_results(context, fitted)):
        expected, std = result.posterior.mean, result.posterior.std
        # The job's effects are drawn with the beam integrated out, and the beam afresh: draws are nearly independent.
        off = np.abs(draws[:, channel].mean(axis=0) - expected) / std
        assert off.max() < 0.5
        assert np.sqrt(np.mean(off**2)) < 0.2
        spread = np.sqrt(np.mean(np.abs(draws[:, channel] - expected) ** 2, axis=0)) / std
        assert 0.8 < np.median(spread) < 1.2
