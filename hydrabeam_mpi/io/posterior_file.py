"""``posterior.h5``: the posterior of every channel, with what is needed to use it elsewhere.

Layout
------
Root attributes: ``basis`` (JSON, see `hydrabeam_mpi.model.bases.base`), ``provenance`` (JSON: resolved job, versions,
checksums, ranks), ``polarization``, ``grid_za`` and ``grid_az`` as data sets (radians).
One group a channel, ``channel_0000`` and so on, with attributes ``freq`` (Hz), ``log_evidence`` (absent with a flat
prior), ``summary`` (JSON) and the data sets

=================  ==================  =========================================================
mean               (n,)                posterior mean of the coefficients, the MAP
covariance         (n, n)              posterior covariance, E[(b - mean)(b - mean)^H]
std                (n,)                square root of its diagonal
prior_mean         (n,)
prior_std          (n,)                infinite where flat
draws              (n_draws, n)        posterior draws
map_mean           (91, 360)           MAP beam on the one-degree grid, zenith angle first
map_std            (91, 360)
map_model          (91, 360)           the model beam before the inference
map_truth          (91, 360)           only where the data were simulated
eigen_variances    (4,)                smallest eigenvalues of the covariance
eigen_beams        (4, 91, 360)        their eigenvectors on the sky
z_edges, z_counts  (Nb + 1,), (2, Nb)  held-out z-scores: inferred beam, model beam
=================  ==================  =========================================================
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.hdf5 import new_hdf5

CHANNEL = "channel_{:04d}"
EIGENBEAMS = 4
REAL_MAPS = 3
MAP_PIXELS = 91 * 360


@dataclass
class ChannelRecord:
    """One channel of the file: its attributes and its data sets, named as in the layout."""

    freq: float
    summary: dict[str, Any]
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    log_evidence: float | None = None


@dataclass
class PosteriorFile:
    """The file in memory."""

    basis: dict[str, Any]
    provenance: dict[str, Any]
    polarization: str
    grid_za: NDArray[Any]
    grid_az: NDArray[Any]
    channels: list[ChannelRecord]


def write_posterior(path: Path, content: PosteriorFile) -> None:
    """Write ``posterior.h5``.

    Raises
    ------
    OSError
        If not all of it could be written.
    """
    with new_hdf5(path) as file:
        file.attrs["basis"] = json.dumps(content.basis)
        file.attrs["provenance"] = json.dumps(content.provenance)
        file.attrs["polarization"] = content.polarization
        file["grid_za"], file["grid_az"] = content.grid_za, content.grid_az
        for number, record in enumerate(content.channels):
            group = file.create_group(CHANNEL.format(number))
            group.attrs["freq"] = record.freq
            group.attrs["summary"] = json.dumps(record.summary)
            if record.log_evidence is not None:
                group.attrs["log_evidence"] = record.log_evidence
            for name, array in record.arrays.items():
                group[name] = array


def least_bytes(n_channels: int, n_modes: int, itemsize: int, n_draws: int) -> int:
    """Return how many bytes the file has at least: covariances, draws and the maps that every channel has."""
    of_coefficients = n_modes * (n_modes + n_draws) + min(n_modes, EIGENBEAMS) * MAP_PIXELS
    return n_channels * (itemsize * of_coefficients + REAL_MAPS * MAP_PIXELS * np.dtype(float).itemsize)


def read_posterior(path: Path) -> PosteriorFile:
    """Read ``posterior.h5``; covariances stay on disk unread.

    Raises
    ------
    InputError
        If the file is missing or is not a posterior of this package.
    """
    try:
        with h5py.File(path) as file:
            channels: list[ChannelRecord] = []
            while (name := CHANNEL.format(len(channels))) in file:
                group = file[name]
                arrays = {key: np.asarray(group[key]) for key in group if key != "covariance"}
                evidence = float(group.attrs["log_evidence"]) if "log_evidence" in group.attrs else None
                summary = json.loads(group.attrs["summary"])
                channels.append(ChannelRecord(float(group.attrs["freq"]), summary, arrays, evidence))
            return PosteriorFile(
                json.loads(file.attrs["basis"]),
                json.loads(file.attrs["provenance"]),
                str(file.attrs["polarization"]),
                np.asarray(file["grid_za"]),
                np.asarray(file["grid_az"]),
                channels,
            )
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            f"is not a posterior file ({error})",
            file=path,
            remedy="name a folder written by 'hydrabeam infer'",
        ) from error


def read_covariance(path: Path, channel: int) -> NDArray[Any]:
    """Read one channel's covariance, (n, n)."""
    with h5py.File(path) as file:
        return np.asarray(file[CHANNEL.format(channel)]["covariance"])
