"""Every mistake a user can make gives one line that names file, field and remedy, exit status 2, and no output."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord
from mpi4py import MPI
from pyradiosky import SkyModel

from hydrabeam_mpi.cli import main
from tests.cli.conftest import OnRoot, Workspace, refusal

pytestmark = pytest.mark.mpi

Edit = Callable[[h5py.File], None]


@dataclass(frozen=True)
class Case:
    """A job with a mistake, and the words that its message must have.

    ``make`` prepares files in the workspace on rank 0; paths in ``changes`` are relative to the job file.
    """

    name: str
    words: tuple[str, ...]
    changes: dict[str, Any] = field(default_factory=dict)
    make: Callable[[Workspace], object] | None = None


def edited(edit: Edit, name: str = "bad.uvh5") -> Callable[[Workspace], None]:
    """Copy the simulated data and change the copy."""

    def make(workspace: Workspace) -> None:
        shutil.copy(workspace.data, workspace.folder / name)
        with h5py.File(workspace.folder / name, "r+") as file:
            edit(file)

    return make


def set_visibility(value: complex, time: int = 0) -> Edit:
    def edit(file: h5py.File) -> None:
        data, times = file["Data/visdata"][()], file["Header/time_array"][()]
        cross = file["Header/ant_1_array"][()] != file["Header/ant_2_array"][()]
        data[np.flatnonzero(cross & (times == np.unique(times)[time]))[-1]] = value
        file["Data/visdata"][...] = data

    return edit


def scale_autos(factor: float) -> Edit:
    def edit(file: h5py.File) -> None:
        data = file["Data/visdata"][()]
        data[file["Header/ant_1_array"][()] == file["Header/ant_2_array"][()]] *= factor
        file["Data/visdata"][...] = data

    return edit


def set_to(path: str, value: object) -> Edit:
    def edit(file: h5py.File) -> None:
        file[path][...] = value

    return edit


def remove_position(file: h5py.File) -> None:
    positions = file["Header/antenna_positions"][()]
    positions[2] = np.nan
    file["Header/antenna_positions"][...] = positions


def renumber_antenna(file: h5py.File) -> None:
    for name in ("Header/ant_1_array", "Header/ant_2_array"):
        numbers = file[name][()]
        file[name][...] = np.where(numbers == 2, 99, numbers)


def remove_autos(file: h5py.File) -> None:
    antpairs = np.stack([file["Header/ant_1_array"][()], file["Header/ant_2_array"][()]])
    cross = antpairs[0] != antpairs[1]
    for group in (file["Header"], file["Data"]):
        for name in [key for key in group if getattr(group[key], "shape", ())[:1] == cross.shape]:
            values = group[name][()][cross]
            del group[name]
            group[name] = values
    file["Header/Nblts"][...] = cross.sum()
    file["Header/Nbls"][...] = len(np.unique(antpairs[:, cross], axis=1).T)


def truncate(workspace: Workspace) -> None:
    whole = workspace.data.read_bytes()
    (workspace.folder / "bad.uvh5").write_bytes(whole[: len(whole) // 2])


def write_hdf5(workspace: Workspace) -> None:
    with h5py.File(workspace.folder / "other.h5", "w") as file:
        file["something"] = 1.0


def write_subband_catalogue(workspace: Workspace) -> None:
    freqs = np.array([180e6, 190e6]) * units.Hz
    SkyModel(
        name=["one"],
        skycoord=SkyCoord([90.0] * units.deg, [-30.0] * units.deg, frame="icrs"),
        stokes=np.array([[[1.0], [1.1]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]]]) * units.Jy,
        spectral_type="subband",
        freq_array=freqs,
        freq_edge_array=np.array([[175e6, 185e6], [185e6, 195e6]]).T * units.Hz,
    ).write_skyh5(workspace.folder / "catalogue.skyh5")


def write_prior_of_another_basis(workspace: Workspace) -> None:
    with h5py.File(workspace.folder / "prior.h5", "w") as file:
        file["mean"], file["covariance"] = np.zeros(16), np.eye(16)
        file.attrs["basis"] = '{"kind": "zernike", "degree": 3}'


def write_text(workspace: Workspace) -> None:
    workspace.write("text.txt", "nothing of the kind\n")


BAD_UVH5 = {"data.files": ["bad.uvh5"]}
CATALOGUE: dict[str, Any] = {"sky.n_sources": None, "sky.kind": "catalogue"}
NO_HEXAGON: dict[str, Any] = {"data.simulate.array": None}
CASES = [
    # Data files.
    Case("missing file", ("missing.uvh5", "[data] files", "check the path"), {"data.files": ["missing.uvh5"]}),
    Case("wildcard without match", ("*.nothing", "[data] files", "check the path"), {"data.files": ["*.nothing"]}),
    Case("truncated file", ("bad.uvh5", "truncated file", "write it again"), BAD_UVH5, truncate),
    Case("text file", ("text.txt", "not a uvh5", "give a uvh5"), {"data.files": ["text.txt"]}, write_text),
    Case("another HDF5 file", ("other.h5", "not a uvh5", "give a uvh5"), {"data.files": ["other.h5"]}, write_hdf5),
    Case("means by transforms", ("job.toml", "[solver] engine", "smearing", "'gemm' or 'auto'"),
         {"data.smearing": True, "solver.engine": "nufft"}),
    Case("folder", ("sub: ", "no visibilities", "give a uvh5"), {"data.files": ["sub"]}, lambda w: mkdir(w, "sub")),
    Case("NaN", ("bad.uvh5", "data_array", "NaN", "flag them"), BAD_UVH5, edited(set_visibility(np.nan))),
    Case("NaN on another rank", ("bad.uvh5", "data_array", "NaN", "flag them"), BAD_UVH5,
         edited(set_visibility(np.nan, time=2))),
    Case("NaN held out", ("bad.uvh5", "data_array", "NaN", "flag them"), BAD_UVH5,
         edited(set_visibility(np.nan, time=3))),
    Case("infinity", ("bad.uvh5", "data_array", "infinite", "flag them"), BAD_UVH5,
         edited(set_visibility(np.inf))),
    Case("all flagged", ("bad.uvh5", "flag_array", "all selected data are flagged", "select other"), BAD_UVH5,
         edited(set_to("Data/flags", True))),
    Case("zero autocorrelations", ("bad.uvh5", "non-positive noise", "[noise] kind"), BAD_UVH5,
         edited(scale_autos(0.0))),
    Case("negative autocorrelations", ("bad.uvh5", "non-positive noise", "[noise] kind"), BAD_UVH5,
         edited(scale_autos(-1.0))),
    Case("no autocorrelations", ("bad.uvh5", "no autocorrelations", "[noise] kind"), BAD_UVH5, edited(remove_autos)),
    Case("antenna without position", ("bad.uvh5", "antenna_positions", "antenna 2", "exclude_antennas"), BAD_UVH5,
         edited(remove_position)),
    Case("antenna unknown to the header", ("bad.uvh5", "antenna_positions", "antenna 99", "exclude_antennas"), BAD_UVH5,
         edited(renumber_antenna)),
    Case("negative frequency in the file", ("bad.uvh5", "freq_array", "-1.31e+08 Hz", "correct the file"), BAD_UVH5,
         edited(set_to("Header/freq_array", -131e6))),
    Case("gains that are not", ("text.txt", "cannot be read as gains", "give calfits"), {"data.gains": ["text.txt"]},
         write_text),
    # What is taken of the data.
    Case("missing polarisation", ("data.uvh5", "polarization_array", '"nn"', 'polarization = "ee"'),
         {"data.polarization": "nn", "beam.source": "gaussian", "beam.diameter": 14.0}),
    Case("negative frequency in the job", ("job.toml", "[data] freqs", "-131 MHz", "more than 0"),
         {"data.freqs": ["-131 MHz"]}),
    Case("missing channel", ("job.toml", "[data] freqs", "150", "the nearest is 131"), {"data.freqs": ["150 MHz"]}),
    Case("missing antenna", ("job.toml", "[data] antennas", "antenna 99", "remove it"), {"data.antennas": [0, 1, 99]}),
    Case("missing times", ("job.toml", "[data] lst_range", "between 6.000 and 6.750 h", "widen"),
         {"data.lst_range": ["1 h", "2 h"]}),
    Case("no baselines", ("job.toml", "[data] max_bl_length", "baselines", "widen"), {"data.max_bl_length": "1 m"}),
    Case("all held out", ("job.toml", "[holdout]", "nothing to fit", "hold out less"),
         {"holdout.kind": "jd", "holdout.jd_ranges": [[2459000.5, 2460000.5]]}),
    Case("nothing held out", ("job.toml", "[holdout]", "holds out nothing", 'kind = "none"'), {"holdout.every": 9}),
    # Noise.
    Case("zero sigma", ("job.toml", "[noise] sigma", "0 Jy", "more than 0"),
         {"noise.kind": "constant", "noise.sigma": "0 Jy"}),
    Case("missing noise file", ("missing.h5", "[noise] file", "check the path"),
         {"noise.kind": "file", "noise.file": "missing.h5"}),
    Case("too few times for differences", ("job.toml", "[noise] kind", "too few adjacent integrations", "another kind"),
         {"noise.kind": "time-differences"}),
    # Sky.
    Case("missing catalogue", ("missing.skyh5", "no such file", "check the path"),
         CATALOGUE | {"sky.file": "missing.skyh5"}),
    Case("catalogue without flux at this frequency", ("catalogue.skyh5", "no flux at 131 MHz", "180 to 190 MHz",
         "another catalogue"), CATALOGUE | {"sky.file": "catalogue.skyh5"}, write_subband_catalogue),
    Case("unknown kind of catalogue", ("text.csv", "'.csv'", "use one of .skyh5"),
         CATALOGUE | {"sky.file": "text.csv"}, lambda w: w.write("text.csv", "1,2,3\n")),
    Case("no source", ("job.toml", "[sky]", "above the horizon", "lower flux_min"), {"sky.flux_min": "1 MJy"}),
    Case("no source modelled", ("job.toml", "[sky]", "above the horizon", "model_flux_min"),
         {"sky.model_flux_min": "1 MJy"}),
    # Beam, basis, prior.
    Case("missing beam", ("missing.beamfits", "[beam] source", "hera-vivaldi-131MHz"),
         {"beam.source": "missing.beamfits"}),
    Case("built-in beam of another polarisation", ("job.toml", "[beam] source", "no 'nn'", "give a beam file"),
         {**BAD_UVH5, "data.polarization": "nn"}, edited(set_to("Header/polarization_array", -6))),
    Case("beam that is not", ("text.txt", "a text file", "name the settings yaml"), {"beam.source": "text.txt"},
         write_text),
    Case("built-in beam at another frequency", ("job.toml", "[beam] source", "131 MHz, not 150 MHz", "'scale'"),
         BAD_UVH5, edited(set_to("Header/freq_array", 150e6))),
    Case("no modes", ("job.toml", "[basis] n_modes", "is 0", "at least 1"), {"basis.n_modes": 0}),
    Case("more modes than there are", ("job.toml", "[basis]", "n_modes = 73", "give 72", "ask for fewer"),
         {"basis.n_modes": 73}),
    Case("more modes than data", ("job.toml", "[prior] kind", "16 coefficients", "6 visibilities", "not flat"),
         {"prior.kind": "flat", "data.antennas": [0, 1, 2]}),
    Case("data that leave modes free", ("job.toml", "[prior]", "leave some beam modes free", "not flat"),
         {"prior.kind": "flat", "basis.n_modes": 72}),
    Case("missing prior", ("missing.h5", "[prior] file", "check the path"),
         {"prior.kind": "file", "prior.file": "missing.h5"}),
    Case("prior that is not", ("other.h5", "[prior] file", "cannot be read as a prior", "tools/ensemble_prior"),
         {"prior.kind": "file", "prior.file": "other.h5"}, write_hdf5),
    Case("prior of another basis", ("prior.h5", "another basis", "[basis]"),
         {"prior.kind": "file", "prior.file": "prior.h5"}, write_prior_of_another_basis),
    # The job file itself; tests/config has more.
    Case("misspelt key", ("job.toml", "[data] polarisation", "unknown key", "did you mean 'polarization'?"),
         {"data.polarisation": "ee"}),
    Case("wrong unit", ("job.toml", "[basis] edge", '"92 m"', "deg"), {"basis.edge": "92 m"}),
    Case("wrong type", ("job.toml", "[basis] n_modes", '"many"', "whole number"), {"basis.n_modes": "many"}),
]  # fmt: skip


def mkdir(workspace: Workspace, name: str) -> None:
    (workspace.folder / name).mkdir()


def prepare(case: Case, workspace: Workspace) -> Path:
    """Make what the case needs, and the job."""
    if case.make:
        case.make(workspace)
    return workspace.job(case.changes)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_infer_refuses(
    case: Case, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    job = on_root(lambda: prepare(case, workspace))
    before = on_root(lambda: sorted(workspace.folder.iterdir()))
    capfd.readouterr()
    assert main(["infer", str(job), "-o", str(workspace.folder / "new" / "result")]) == 2
    line = refusal(capfd, comm)
    assert [word for word in case.words if word not in line] == []
    assert "; " in line
    assert on_root(lambda: sorted(workspace.folder.iterdir())) == before


SIMULATIONS = [
    Case("negative frequency", ("job.toml", "[data.simulate] freqs", "more than 0"),
         {"data.simulate.freqs": ["-131 MHz"]}),
    Case("no hexagon", ("job.toml", "[data.simulate.array]", "[4, 3]", "[4, 7]"), {"data.simulate.array.hex": [4, 3]}),
    Case("missing layout", ("missing.csv", "no such file", "check the path"),
         NO_HEXAGON | {"data.simulate.array.file": "missing.csv"}),
    Case("antenna without position", ("layout.csv", "antenna 1", "columns"),
         NO_HEXAGON | {"data.simulate.array.file": "layout.csv"},
         lambda w: w.write("layout.csv", "E,N,U\n0,0,0\nnan,1,0\n2,2,0\n")),
    Case("no source", ("job.toml", "[sky]", "above the horizon", "lower flux_min"), {"sky.flux_min": "1 MJy"}),
    Case("no cross-polarised beam", ("job.toml", "[beam] source", "no 'en'", "give a beam file"),
         {"data.polarization": "en"}),
    Case("antennas in one place", ("layout.csv", "antennas 0 and 1", "in one place"),
         NO_HEXAGON | {"data.simulate.array.file": "layout.csv"},
         lambda w: w.write("layout.csv", "E,N,U\n0,0,0\n0,0,0\n2,2,0\n")),
    Case("antennas closer than one counts", ("job.toml", "[data.simulate.array]", "antennas 0 and 1", "1e-07 m"),
         {"data.simulate.array.spacing": "1 nm"}),
    Case("a tolerance that takes all for one", ("job.toml", "antennas 0 and 1", "redundancy_tol = 15 m", "smaller"),
         {"data.redundancy_tol": "15 m"}),
    Case("more sources than memory", ("job.toml", "[sky] n_sources = 1000000000000", "GB", "ask for less"),
         {"sky.n_sources": 10**12}),
    Case("a spectrum that no source has", ("job.toml", "[sky] spectral_index", "orders of magnitude", "100 to 131 MHz"),
         {"sky.spectral_index": 1e4}),
    Case("effects too strong for numbers", ("job.toml", "number 1 (diffuse)", "numbers can tell", "lower its strength"),
         {"data.simulate.effects": [{"kind": "diffuse", "strength": 1.7e308}]}),
    Case("gains beyond reason", ("job.toml", "channel 0 (131 MHz)", "simulated ee: reaches", "lower the fluxes"),
         {"data.simulate.effects": [{"kind": "antenna_gains", "strength": 1e4}]}),
    Case("effects beyond what is read of a file", ("job.toml", "channel 0 (131 MHz)", "simulated ee: reaches", "Jy"),
         {"data.simulate.effects": [{"kind": "antenna_gains", "parameters": {"antenna 1 ln amplitude": 500.0}}]}),
    Case("settings of another kind", ("job.toml", "number 1 (diffuse) settings", "are not understood", "l_max"),
         {"data.simulate.effects": [{"kind": "diffuse", "settings": {"l_max": 10**12}}]}),
    Case("modes beyond the last", ("job.toml", "number 1 (basis_truncation)", "no modes come after", "remove it"),
         {"data.simulate.effects": [{"kind": "basis_truncation", "settings": {"n_before": 10**12}}]}),
    Case("nothing to simulate", ("job.toml", "[data.simulate]", "is missing", "add it"),
         {"data.simulate": None, "data.files": ["data.uvh5"]}),
]  # fmt: skip


@pytest.mark.parametrize("case", SIMULATIONS, ids=lambda case: case.name)
def test_simulate_refuses(
    case: Case, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    on_root(lambda: case.make and case.make(workspace))
    job = on_root(lambda: workspace.simulation(case.changes))
    before = on_root(lambda: sorted(workspace.folder.iterdir()))
    assert main(["simulate", str(job), "-o", str(workspace.folder / "result")]) == 2
    line = refusal(capfd, comm)
    assert [word for word in case.words if word not in line] == []
    assert "; " in line
    assert on_root(lambda: sorted(workspace.folder.iterdir())) == before


def test_beam_file_without_the_frequency(
    result: Path, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    case = Case(
        "", (), BAD_UVH5 | {"beam.source": str(result / "beam.beamfits")}, edited(set_to("Header/freq_array", 150e6))
    )
    job = on_root(lambda: prepare(case, workspace))
    assert main(["infer", str(job), "-o", str(workspace.folder / "result")]) == 2
    line = refusal(capfd, comm)
    assert "beam.beamfits: freq: the beam covers 131-131 MHz, not 150 MHz; choose channels within it" in line
