"""Good files of every kind, small enough that a run takes a third of a second; made once, then damaged in copies."""

from __future__ import annotations

import runpy
import shutil
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import tomli_w
from astropy import units
from astropy.coordinates import SkyCoord
from astropy.io.votable import from_table
from astropy.table import Table
from pyradiosky import SkyModel
from pyuvdata import UVData

from hydrabeam_mpi.cli import main
from tests.cli.conftest import changed
from tests.loop.mock import FREQ, mock_job
from tests.report.conftest import BULK, drop_arrays
from tests.visibilities import make_uvcal

REPOSITORY = Path(__file__).parents[2]
FREQS = (FREQ, FREQ + 1e6)
GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}


def simulation() -> dict[str, Any]:
    """A job of seven antennas that simulates its data, with most of its keys given."""
    job = mock_job(GAIN, freqs=FREQS, n_times=6)
    job["sky"]["n_sources"] = 60
    job["data"]["simulate"] |= {
        "channel_width": "1 MHz", "latitude": -30.7215, "longitude": 21.4283, "height": 1051.69, "start": 2459866.0,
        "lst_range": [6.0, 12.0], "integration_time": 10.0, "noise": True,
    }  # fmt: skip
    job["data"] |= {"polarization": "ee", "redundancy_tol": 1e-7, "min_bl_length": 0.0, "max_bl_length": 1000.0}
    job["data"] |= {"exclude_antennas": [6], "every_time": 1}
    job["noise"] = {"kind": "autocorrelations"}
    job["sky"] |= {"flux_range": [0.1, 100.0], "spectral_index": -2.7, "reference_freq": 100e6, "flux_min": 0.01}
    job["sky"] |= {"model_flux_min": 0.01, "kind": "mock", "positions": "lst"}
    job["basis"] |= {"kind": "fourier-bessel", "form": "real", "edge": 92.0, "boundary": "neumann"}
    job["prior"] = {"kind": "fraction", "fraction": 1.0, "floor": 1e-6}
    job["solver"] = {"engine": "gemm", "compress": True}
    job["loop"] = {"effects": ["antenna_gains", "noise_level"], "max_rounds": 1, "min_log_bayes_factor": 5.0}
    return job


def from_files(samples: Path, **changes: Any) -> dict[str, Any]:
    """A job that reads the simulated data; ``data__files`` stands for the key files of [data]."""
    files = {"data.simulate": None, "data.files": [str(samples / "data.uvh5")]}
    return changed(simulation(), files | {name.replace("__", "."): value for name, value in changes.items()})


Job = Callable[[Path, Path], dict[str, Any]]


@dataclass(frozen=True)
class Target:
    """A kind of file that is damaged, and the command that reads it.

    Attributes
    ----------
    name : str
        Of the file in the folder of samples; a folder itself for a measurement set, miriad or a result.
    command : str
        Of the program.
    damage : tuple of str
        Families of mutations that it can suffer.
    job : callable, optional
        ``job(samples, file)`` makes the job that reads ``file``; none where the file is the argument.
    inside : str
        The file within a folder that is damaged; any of them if empty.
    weight : float
        How often it is drawn.
    """

    name: str
    command: str
    damage: tuple[str, ...]
    job: Job | None = None
    inside: str = ""
    weight: float = 1.0

    @property
    def is_quick(self) -> bool:
        """Whether neither figures are drawn nor a process of its own reads the file first."""
        return self.command != "report" and self.name not in ("data.ms", "data.miriad")

    @property
    def title(self) -> str:
        """What to call it."""
        return f"{self.command} {self.name}{'/' + self.inside if self.inside else ''}"


def _with(key: str, as_list: bool = False, **more: Any) -> Job:
    """Return a maker of jobs with a key that names the file, and other keys."""

    def job(samples: Path, file: Path) -> dict[str, Any]:
        return from_files(samples, **more, **{key: [str(file)] if as_list else str(file)})

    return job


def _laid_out(samples: Path, file: Path) -> dict[str, Any]:
    return changed(simulation(), {"data.simulate.array": {"file": str(file)}, "data.exclude_antennas": None})


def _after(samples: Path, file: Path) -> dict[str, Any]:
    """Return a job whose prior is a result of another night."""
    files = [str(samples / "next.uvh5")]
    return from_files(samples, data__files=files, prior={"kind": "file"}, prior__file=str(file))


_BYTES, _HDF5, _FITS, _TEXT, _TOML, _JSON = ("bytes",), ("bytes", "hdf5", "hdf5", "hdf5"), ("bytes", "fits", "fits"), (
    "bytes", "text",
), ("text", "toml", "toml", "toml", "toml"), ("text", "json", "json")  # fmt: skip
_DATA = _with("data__files", True)
_CATALOGUE = {"sky": {"kind": "catalogue", "positions": "apparent", "reference_freq": 100e6, "flux_min": 0.01}}
_COLUMNS = {
    "table": "sources", "name": "name", "lon": "ra", "lat": "dec", "frame": "icrs", "flux": ["flux"],
    "reference_freq": FREQS[0], "spectral_index": "alpha",
}  # fmt: skip

TARGETS = (
    Target("data.uvh5", "infer", _HDF5, _DATA, weight=4),
    Target("data.uvh5", "loop", _HDF5, _DATA, weight=0.7),
    Target("data.uvh5", "init", _HDF5),
    Target("data.uvfits", "infer", _FITS, _DATA, weight=2),
    Target("data.uvfits", "init", _FITS, weight=0.5),
    Target("data.ms", "infer", _BYTES, _DATA, weight=0.7),
    Target("data.miriad", "infer", _BYTES, _DATA, weight=0.3),
    Target("gains.calfits", "infer", _FITS, _with("data__gains", True), weight=1.5),
    Target("gains.calh5", "infer", _HDF5, _with("data__gains", True), weight=1.5),
    Target("beam.beamfits", "infer", _FITS, _with("beam__source", beam__diameter=None), weight=1.5),
    Target("sky.skyh5", "infer", _HDF5, _with("sky__file", **_CATALOGUE), weight=1.5),
    Target("sky.txt", "infer", _TEXT, _with("sky__file", **_CATALOGUE)),
    Target("sky.vot", "infer", _TEXT, _with("sky__file", **_CATALOGUE, sky__columns=_COLUMNS)),
    Target("prior.h5", "infer", _HDF5, _with("prior__file", prior={"kind": "file"}), weight=1.5),
    Target("noise.h5", "infer", _HDF5, _with("noise__file", noise__kind="file"), weight=1.5),
    Target("noise.npz", "infer", _BYTES, _with("noise__file", noise__kind="file")),
    Target("layout.txt", "simulate", _TEXT, _laid_out),
    Target("simulation.toml", "simulate", _TOML, weight=3),
    Target("simulation.toml", "infer", _TOML, weight=3),
    Target("files.toml", "infer", _TOML, weight=3),
    Target("files.toml", "loop", _TOML),
    Target("amended.toml", "infer", _TOML, weight=2),
    Target("both", "infer", _HDF5, _after, inside="posterior.h5"),
    Target("both", "predict", _HDF5, lambda samples, file: from_files(samples), inside="posterior.h5"),
    Target("data.uvh5", "predict", _HDF5, _DATA),
    Target("data.uvh5", "correct", _HDF5, _DATA),
    Target("result", "report", _HDF5, inside="posterior.h5", weight=0.4),
    Target("result", "report", _JSON, inside="summary.json", weight=0.3),
    Target("looped", "report", _JSON, inside="loop.json", weight=0.3),
)


def make(folder: Path) -> None:
    """Make all samples."""
    folder.mkdir(parents=True, exist_ok=True)
    _run("simulate", folder, simulation(), "mock")
    shutil.copy(folder / "mock" / "data.uvh5", folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _visibilities(folder)
        _catalogues(folder)
    (folder / "simulation.toml").write_text(tomli_w.dumps(simulation()))
    (folder / "files.toml").write_text(tomli_w.dumps(from_files(folder)))
    _run("loop", folder, from_files(folder), "both")
    shutil.copy(folder / "both" / "amended.toml", folder)
    shutil.copy(folder / "both" / "beam.beamfits", folder)
    for command, name in (("infer", "result"), ("loop", "looped")):
        _run(command, folder, from_files(folder, data__channels=[0]), name)
        drop_arrays(folder / name, *(kept for kept in BULK if kept != "map_truth"))
    _tables(folder)


def _run(command: str, folder: Path, job: dict[str, Any], name: str) -> None:
    (folder / f"{name}.toml").write_text(tomli_w.dumps(job))
    assert main([command, str(folder / f"{name}.toml"), "-o", str(folder / name)]) == 0


def _visibilities(folder: Path) -> None:
    uv = UVData.from_file(str(folder / "data.uvh5"))
    cal = make_uvcal(uv, times=np.unique(uv.time_array), numbers=uv.telescope.antenna_numbers, jones=(-5,))
    cal.gain_array = 1 + 0.01 * (cal.gain_array - 1)
    cal.write_calfits(str(folder / "gains.calfits"))
    cal.write_calh5(str(folder / "gains.calh5"))
    uv.write_uvfits(str(folder / "data.uvfits"), force_phase=True)
    # What another night of the same sky gives, but for its noise.
    another = UVData.from_file(str(folder / "data.uvh5"))
    another.data_array *= 1 + 1e-6
    another.write_uvh5(str(folder / "next.uvh5"))
    again = UVData.from_file(str(folder / "data.uvh5"))
    again.write_ms(str(folder / "data.ms"), force_phase=True)
    UVData.from_file(str(folder / "data.uvh5")).write_miriad(str(folder / "data.miriad"))


def _catalogues(folder: Path) -> None:
    with h5py.File(folder / "mock" / "truth.h5") as file:
        ra, dec, flux = (np.asarray(file[name][()], float) for name in ("ra", "dec", "flux"))
    n, flux = len(ra), flux[0]
    names = [f"source_{i}" for i in range(n)]
    stokes = np.zeros((4, 1, n))
    stokes[0] = flux
    model = SkyModel(
        name=names,
        skycoord=SkyCoord(ra, dec, unit="rad", frame="icrs"),
        stokes=stokes * units.Jy,
        spectral_type="spectral_index",
        spectral_index=np.full(n, -2.7),
        reference_frequency=np.full(n, FREQS[0]) * units.Hz,
    )
    model.write_skyh5(folder / "sky.skyh5")
    model.write_text_catalog(folder / "sky.txt")
    table = Table({"name": names, "ra": np.rad2deg(ra), "dec": np.rad2deg(dec), "flux": flux, "alpha": [-2.7] * n})
    table["ra"].unit = table["dec"].unit = "deg"
    table["flux"].unit = "Jy"
    votable = from_table(table)
    votable.get_first_table().name = votable.get_first_table()._ID = "sources"
    votable.to_xml(str(folder / "sky.vot"))


def _tables(folder: Path) -> None:
    sigma = np.array([0.5, 0.6])
    with h5py.File(folder / "noise.h5", "w") as file:
        file["freqs"], file["sigma"] = np.array(FREQS), sigma
    np.savez(folder / "noise.npz", freqs=np.array(FREQS), sigma=sigma)
    rng = np.random.default_rng(5)
    places = rng.uniform(-40, 40, (6, 3)) * [1, 1, 0.01]
    (folder / "layout.txt").write_text(
        "E N U\n" + "\n".join(" ".join(f"{x:.3f}" for x in row) for row in places) + "\n"
    )
    make_prior = runpy.run_path(str(REPOSITORY / "tools" / "ensemble_prior"))["main"]
    assert make_prior([str(folder / "simulation.toml"), str(folder / "prior.h5"), "--n-beams", "40"]) == 0
