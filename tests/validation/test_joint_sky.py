"""What `tools/study_joint_sky` compares: a beam with a wrong sky, with the missing sources beside it, and truth."""

from __future__ import annotations

from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.setup.job_file import load

TOOL = Path(__file__).parents[2] / "tools" / "study_joint_sky"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = spec_from_loader(TOOL.name, SourceFileLoader(TOOL.name, str(TOOL)))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_missing_sources_give_the_beam_back(tool: ModuleType) -> None:
    """Where their places are known, not their fluxes; with errors that say how well."""
    found = tool.study(tool.reduced_job(2), ("wrong sky", "places"), MPI.COMM_SELF)
    wrong, joint = found["wrong sky"], found["places"]
    assert joint["beam_error"] < 0.5 * wrong["beam_error"]
    assert joint["rms_jy"] < 0.6 * wrong["rms_jy"]
    assert joint["beam_error"] < 2 * joint["stated_error"] < wrong["beam_error"]
    assert wrong["chi2"] > 4
    assert 0.5 < joint["chi2"] < 1.5


def test_priors_have_the_power_of_what_is_missing(tool: ModuleType) -> None:
    job = tool.job_of(tool.reduced_job(1))
    (freq,) = job.data.simulate.freqs
    places, width = tool.known_places(job, freq)
    assert places.Nsrc == pytest.approx(200, abs=40)
    assert np.mean(places.flux**2) == pytest.approx(width**2, rel=0.3)
    grid, each = tool.pixels(job, freq)
    assert grid.Nsrc * each**2 == pytest.approx(200 * width**2)


def test_the_job_to_sample_from_has_the_places(tool: ModuleType, tmp_path: Path) -> None:
    tool.write(tmp_path)
    (effect,) = load(MPI.COMM_SELF, tmp_path / "job.toml").effects
    assert len(effect.index) == len(effect.settings["sources"]) == 3314
    assert set(np.diff(effect.index)) == {3}
