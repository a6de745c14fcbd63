"""``posterior.h5``: the posterior of every channel, with what is needed to use it elsewhere.

Layout
------
Root attributes: ``format``, the version of this layout (1; files without it have the same), ``basis`` (JSON, see
`hydrabeam_mpi.model.bases.base`), ``provenance`` (JSON: resolved job, versions, checksums, ranks), ``polarization``,
``telescope_name``; ``grid_za`` and ``grid_az`` are data sets (radians). Those of numbers have ``units`` and
``long_name``.
Where effects were part of the model a data set ``effects`` (JSON): ``basis``, that of the beam without the functions
that effects add to it; ``entries``, the effects as in a job's ``[[effects]]``, each with the names of all of its
parameters, ``known``.
Where beams hang together over frequency an attribute ``over_frequency`` (JSON): ``settings``, those of the job's
``[prior.frequency]``; how they were solved for, and what the evidence says of it.
A group ``observed`` tells what was observed: antennas, groups of baselines, tracks of sources, and of which times and
baselines the sample of held-out visibilities is.
One group a channel, ``channel_0000`` and so on, with attributes ``freq`` (Hz), ``log_evidence`` (absent with a flat
prior), ``summary`` (JSON) and the data sets

=================  ==================  =========================================================
mean               (n,)                posterior mean of the coefficients, the MAP
covariance         (n, n)              posterior covariance, E[(b - mean)(b - mean)^H]
std                (n,)                square root of its diagonal
prior_mean         (n,)
prior_std          (n,)                infinite where flat
model_mean         (m,)                only with a result as prior: the model beam in the basis
draws              (n_draws, n)        posterior draws
map_mean           (91, 360)           MAP beam on the one-degree grid, zenith angle first
map_std            (91, 360)
map_model          (91, 360)           the model beam before the inference
map_truth          (91, 360)           only where the data were simulated
eigen_variances    (4,)                smallest eigenvalues of the covariance
eigen_beams        (4, 91, 360)        their eigenvectors on the sky
z_edges, z_counts  (Nb + 1,), (2, Nb)  held-out z-scores: inferred beam, model beam
information        (n, n)              only of beams that hang together: kappa A^H N^-1 A of the channel's data
score              (n,)                only of these: kappa A^H N^-1 (d - A prior_mean); kappa = 2 where real, else 1
heldout_data       (Nt, Ns)            of Ns baselines a sample of the held-out visibilities as they were read
heldout_before     (Nt, Ns)            what the model beam predicts of them, with nothing fitted
heldout_after      (Nt, Ns)            what the inferred beam predicts of them, with the effects of the model
heldout_weights    (Nt, Ns)            one over the variance of their noise; zero where flagged
baseline_n         (Nbls,)             number of held-out visibilities of each of all baselines
baseline_chi2      (2, Nbls)           their reduced chi^2: before, after; zero where there are none
=================  ==================  =========================================================

With ``information`` and ``score`` all channels can be drawn from together (`hydrabeam_mpi.inference.coupled`), as
``draws`` are. Of q parameters of effects in use, side by side, there are ``effects_covariance``, (q, q), and
``effects_beam_response``, (m, q): by how much the first m coefficients, those in ``basis``, move when one of these
parameters does.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.formats import FORMAT, check_format, describe
from hydrabeam_mpi.io.hdf5 import new_hdf5
from hydrabeam_mpi.io.kept_rounds import check_ended
from hydrabeam_mpi.io.posterior_names import LONG_NAMES, OBSERVED, UNITS
from hydrabeam_mpi.io.reading import check_file, reading

POSTERIOR_FORMAT = 1
CHANNEL = "channel_{:04d}"
_REMEDY = "name a folder written by 'hydrabeam infer'"
EIGENBEAMS = 4
REAL_MAPS = 3
_NEEDED = ("mean", "std", "prior_mean", "prior_std", "covariance")
MAP_PIXELS = 91 * 360
ON_DISK = ("covariance", "information")
"""Data sets that are not read with the others, as they are large."""


@dataclass
class ChannelRecord:
    """One channel of the file: its attributes and its data sets, named as in the layout."""

    freq: float
    summary: dict[str, Any]
    arrays: dict[str, Array] = field(default_factory=dict)
    log_evidence: float | None = None


@dataclass
class PosteriorFile:
    """The file in memory."""

    basis: dict[str, Any]
    provenance: dict[str, Any]
    polarization: str
    grid_za: Array
    grid_az: Array
    channels: list[ChannelRecord]
    telescope_name: str = "unknown"
    effects: dict[str, Any] | None = None
    over_frequency: dict[str, Any] | None = None
    observed: dict[str, Array] = field(default_factory=dict)


def write_posterior(path: Path, content: PosteriorFile) -> None:
    """Write ``posterior.h5``.

    Raises
    ------
    OSError
        If not all of it could be written.
    """
    with new_hdf5(path) as file:
        file.attrs[FORMAT] = POSTERIOR_FORMAT
        file.attrs["basis"] = json.dumps(content.basis)
        file.attrs["provenance"] = json.dumps(content.provenance)
        file.attrs["polarization"] = content.polarization
        file.attrs["telescope_name"] = content.telescope_name
        file["grid_za"], file["grid_az"] = content.grid_za, content.grid_az
        describe(file["grid_za"], "rad", "zenith angle of the maps")
        describe(file["grid_az"], "rad", "azimuth of the maps, from East through North")
        if content.effects is not None:
            file["effects"] = json.dumps(content.effects)
        if content.over_frequency is not None:
            file.attrs["over_frequency"] = json.dumps(content.over_frequency)
        for name, array in content.observed.items():
            file[f"observed/{name}"] = array
            describe(file[f"observed/{name}"], *OBSERVED[name])
        for number, record in enumerate(content.channels):
            group = file.create_group(CHANNEL.format(number))
            group.attrs["freq"] = record.freq
            group.attrs["summary"] = json.dumps(record.summary)
            if record.log_evidence is not None:
                group.attrs["log_evidence"] = record.log_evidence
            for name, array in record.arrays.items():
                group[name] = array
                describe(group[name], UNITS.get(name, "1"), LONG_NAMES[name])


def least_bytes(n_channels: int, n_modes: int, itemsize: int, n_draws: int, n_matrices: int = 1) -> int:
    """Return how many bytes the file has at least: matrices, draws and the maps that every channel has."""
    of_coefficients = n_modes * (n_matrices * n_modes + n_draws) + min(n_modes, EIGENBEAMS) * MAP_PIXELS
    return n_channels * (itemsize * of_coefficients + REAL_MAPS * MAP_PIXELS * np.dtype(float).itemsize)


def read_posterior(path: Path) -> PosteriorFile:
    """Read ``posterior.h5``; covariances stay on disk unread.

    Raises
    ------
    InputError
        If the file is missing, as that of a loop that was interrupted, or is not a posterior of this package.
    """
    check_ended(path.parent)
    check_file(path, remedy=_REMEDY)
    with reading(path, "a posterior", remedy=_REMEDY), h5py.File(path, "r") as file:
        check_format(file.attrs.get(FORMAT), POSTERIOR_FORMAT)
        za, az = (_numbers(file, name) for name in ("grid_za", "grid_az"))
        channels: list[ChannelRecord] = []
        while (name := CHANNEL.format(len(channels))) in file:
            channels.append(_read_channel(file[name], name, (len(za), len(az))))
        basis, provenance = (_json(file, name, "") for name in ("basis", "provenance"))
        telescope_name = str(file.attrs.get("telescope_name", "unknown"))
        polarization = str(file.attrs["polarization"])
        effects = _table(file["effects"][()], "effects") if "effects" in file else None
        coupled = _json(file, "over_frequency", "") if "over_frequency" in file.attrs else None
        observed = {name: _numbers(file["observed"], name) for name in file.get("observed", ())}
        return PosteriorFile(
            basis, provenance, polarization, za, az, channels, telescope_name, effects, coupled, observed
        )


def _read_channel(group: h5py.Group, name: str, grid: tuple[int, int]) -> ChannelRecord:
    """Read a channel, and make sure that its arrays fit together."""
    if not isinstance(group, h5py.Group):
        raise InputError("is not a group of data sets", field=name, remedy=_REMEDY)
    missing = next((key for key in _NEEDED if key not in group), None)
    if missing:
        raise InputError("is missing", field=f"{name}/{missing}", remedy=_REMEDY)
    for key, shape in _shapes(group, grid).items():
        if key in group and group[key].shape != shape:
            told = f"has the shape {group[key].shape}, not {shape}"
            raise InputError(told, field=f"{name}/{key}", remedy=_REMEDY)
    arrays = {key: _numbers(group, key, endless=key == "prior_std") for key in group if key not in ON_DISK}
    for key in ("std", "prior_std"):
        if not np.all(arrays[key] > 0):
            raise InputError("holds a standard deviation that is not positive", field=f"{name}/{key}", remedy=_REMEDY)
    evidence = float(group.attrs["log_evidence"]) if "log_evidence" in group.attrs else None
    return ChannelRecord(float(group.attrs["freq"]), _json(group, "summary", name), arrays, evidence)


def _shapes(group: h5py.Group, grid: tuple[int, int]) -> dict[str, tuple[int, ...]]:
    """Return the shapes that a channel's data sets must have, where they are there."""
    n = group["mean"].size
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("mean", "std", "prior_mean", "prior_std", "score"), (n,))
    shapes |= dict.fromkeys(ON_DISK, (n, n))
    if "model_mean" in group:
        shapes["model_mean"] = (min(n, len(group["model_mean"])),)
    shapes |= {key: grid for key in group if key.startswith("map_")}
    if "eigen_variances" in group:
        shapes["eigen_beams"] = (group["eigen_variances"].size, *grid)
    if "effects_covariance" in group:
        q = group["effects_covariance"].shape[0]
        shapes["effects_covariance"] = (q, q)
        # Functions that effects have added to the basis come after those that respond.
        shapes["effects_beam_response"] = (min(n, len(group["effects_beam_response"])), q)
    if "z_edges" in group:
        shapes["z_counts"] = (2, group["z_edges"].size - 1)
    return shapes


def _numbers(group: h5py.Group, name: str, endless: bool = False) -> Array:
    """Read a data set of numbers; ``endless`` ones, such as the width of a flat prior, may be infinite."""
    values = np.asarray(group[name][()])
    if values.ndim == 0 or values.dtype.kind not in "iufc":
        raise InputError("is not an array of numbers", field=name, remedy=_REMEDY)
    if values.dtype.kind in "fc" and not np.all((np.abs(values) <= LARGEST) | (endless & np.isinf(values))):
        raise InputError(f"holds a number that is not finite, or beyond {LARGEST:g}", field=name, remedy=_REMEDY)
    return values


def _json(group: h5py.Group, name: str, place: str) -> dict[str, Any]:
    """Read an attribute that is a table in JSON."""
    return _table(group.attrs[name], f"{place} {name}".strip())


def _table(text: str | bytes, field: str) -> dict[str, Any]:
    """Return a table in JSON."""
    table = json.loads(text)
    if not isinstance(table, dict):
        raise InputError("is not a table", field=field, remedy=_REMEDY)
    return table


def read_covariance(path: Path, channel: int) -> Array:
    """Read one channel's covariance, (n, n).

    Raises
    ------
    InputError
        If it cannot be read.
    """
    covariance = read_matrix(path, channel, "covariance")
    if not np.all(np.diag(covariance).real > 0):
        field = f"{CHANNEL.format(channel)}/covariance"
        raise InputError("holds a variance that is not positive", file=path, field=field, remedy=_REMEDY)
    return covariance


def read_matrix(path: Path, channel: int, name: str) -> Array:
    """Read one channel's data set that is not read with the others, (n, n).

    Raises
    ------
    InputError
        If it cannot be read.
    """
    with reading(path, "a posterior", remedy=_REMEDY), h5py.File(path, "r") as file:
        return _numbers(file[CHANNEL.format(channel)], name)
