"""Two nights of one array and sky, the first of which has been fitted."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyuvdata import UVData

from hydrabeam_mpi.cli import main
from tests.loop.mock import mock_job, write_job
from tests.loop.test_loop_command import GAIN, TWO
from tests.loop.test_missing_source import NAME, PLACE

SOURCE = {"kind": "missing_sources", "settings": {"sources": [list(PLACE)]}, "parameters": {NAME + "flux": 3.0}}
JOB = mock_job(GAIN, SOURCE, freqs=TWO, loop={"effects": ["antenna_gains", "missing_sources"], "max_rounds": 2})


@dataclass(frozen=True)
class Nights:
    """What is on disk: data of either night, and the result of the first.

    An antenna's gain is off in both, and the catalogue lacks a source. Every third time of the first night is held out.
    """

    folder: Path

    @classmethod
    def make(cls, folder: Path) -> Nights:
        """Simulate both and fit the first."""
        nights = cls(folder)
        nights._simulate("first", {})
        nights._simulate("second", {"start": 2459867.0, "lst_range": ["6.1 h", "12.1 h"], "noise": False})
        _add_noise(nights.data("second"))
        assert main(["loop", str(nights.job("first")), "-o", str(nights.result)]) == 0
        return nights

    def _simulate(self, night: str, changes: dict[str, Any]) -> None:
        settings = {**JOB["data"]["simulate"], **changes}
        job = write_job({**JOB, "data": {"simulate": settings}}, self.folder, f"{night}_simulated.toml")
        assert main(["simulate", str(job), "-o", str(self.folder / night)]) == 0

    @property
    def result(self) -> Path:
        """What the loop wrote of the first night."""
        return self.folder / "result"

    def data(self, night: str) -> Path:
        return self.folder / night / "data.uvh5"

    def job(self, night: str, name: str = "", **selection: Any) -> Path:
        """Write a job of a night's data, with some keys of ``[data]``."""
        data = {"files": [str(self.data(night))], **selection}
        return write_job({**JOB, "data": data}, self.folder, f"{night}{name}.toml")


def predicted(*arguments: Path | str) -> dict[str, Any]:
    """Run `hydrabeam predict RESULT JOB.toml -o DIR` and return what it wrote."""
    result, job, out = map(str, arguments)
    assert main(["predict", result, job, "-o", out]) == 0
    return dict(json.loads((Path(out) / "prediction.json").read_text()))


def _add_noise(path: Path) -> None:
    """Add the noise of the radiometer equation, which that of the other night knows nothing of."""
    uvd, rng = UVData.from_file(str(path)), np.random.default_rng(11)
    samples = uvd.channel_width * np.unique(uvd.integration_time)
    for one, two in uvd.get_antpairs():
        if one != two:
            rows = uvd.antpair2ind(one, two)
            power = np.abs([uvd.data_array[uvd.antpair2ind(ant, ant)] for ant in (one, two)]).prod(axis=0)
            sigma = np.sqrt(power / samples[:, np.newaxis] / 2)
            uvd.data_array[rows] += sigma * (rng.standard_normal(sigma.shape) + 1j * rng.standard_normal(sigma.shape))
    uvd.write_uvh5(str(path), clobber=True)
