"""What files of visibilities hold, including their flags: enough to set up a job."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydrabeam_mpi.data.observation import IntArray, Observation
from hydrabeam_mpi.data.selection import BoolArray, Selection, match
from hydrabeam_mpi.io.uvdata import check_nsamples
from hydrabeam_mpi.io.uvfile import UVHeader, read_metadata, read_uvdata
from hydrabeam_mpi.io.uvformat import READ_IN_PART
from hydrabeam_mpi.io.uvmeta import FREQ_TOLERANCE, linear_pols, read_observation
from hydrabeam_mpi.io.uvrows import SAMPLE_BYTES, WINDOW_BYTES, read_samples


@dataclass(frozen=True, eq=False)
class Summary:
    """What is known of some files, in one polarisation where it concerns the samples.

    Attributes
    ----------
    observation : Observation
        All that the files hold.
    pol : str
        The first co-polarised one, or else the first.
    flagged_channels : ndarray of bool, (Nfreqs,)
        Without any unflagged cross-correlation.
    flagged_antennas : tuple of int
        Likewise.
    nsamples : tuple of float
        The smallest and the largest of unflagged cross-correlations; empty where there are none.
    has_autos : bool
        Whether every antenna that is not flagged has autocorrelations.
    units, pol_conventions : tuple of str
        What the files state; empty where they state nothing.
    """

    observation: Observation
    pol: str
    flagged_channels: BoolArray
    flagged_antennas: tuple[int, ...]
    nsamples: tuple[float, ...]
    has_autos: bool
    units: tuple[str, ...]
    pol_conventions: tuple[str, ...]


def summarise(files: Sequence[Path]) -> Summary:
    """Read all flags of some files, a part at a time.

    Raises
    ------
    InputError
        If a file cannot be used, or the files do not fit together.
    """
    observation = read_observation(files, Selection())
    pol = _first_pol(observation.pols, files[0])
    good_channels = np.zeros(observation.Nfreqs, dtype=bool)
    good_antennas: set[int] = set()
    autos: set[int] = set()
    nsamples: set[float] = set()
    stated: dict[str, set[str]] = {"vis_units": set(), "pol_convention": set()}
    for path in files:
        header, rows = read_metadata(path)
        cross = rows.antpairs[:, 0] != rows.antpairs[:, 1]
        autos |= set(rows.antpairs[~cross, 0].tolist())
        channels = match(header.freqs, observation.freqs, FREQ_TOLERANCE)
        for part, good, samples in _parts(header, np.flatnonzero(cross), pol):
            good_channels[channels] |= good.any(axis=0)
            good_antennas |= set(rows.antpairs[part[good.any(axis=1)]].ravel().tolist())
            nsamples |= set(samples)
        uv = read_uvdata(path, header.kind, **({"read_data": False} if header.kind in READ_IN_PART else {}))
        for name, values in stated.items():
            values |= {str(getattr(uv, name))} if getattr(uv, name) else set()
    return Summary(
        observation=observation,
        pol=pol,
        flagged_channels=~good_channels,
        flagged_antennas=tuple(sorted(set(observation.antenna_numbers.tolist()) - good_antennas)),
        nsamples=(min(nsamples), max(nsamples)) if nsamples else (),
        has_autos=bool(good_antennas) and good_antennas <= autos,
        units=tuple(sorted(stated["vis_units"])),
        pol_conventions=tuple(sorted(stated["pol_convention"])),
    )


def _first_pol(pols: Sequence[str], path: Path) -> str:
    """Choose a polarisation that the model has a word for."""
    linear = linear_pols(pols, path)
    return next((pol for pol in linear if pol[0] == pol[1]), linear[0])


def _parts(header: UVHeader, rows: IntArray, pol: str) -> Iterator[tuple[IntArray, BoolArray, list[float]]]:
    """Yield rows, which of their samples are good, (Nrows, Nfreqs), and the range of those samples' nsamples."""
    where = header.pol_index(pol)
    if where < 0 or not rows.size:
        return
    channels = np.arange(len(header.freqs))
    # Other formats are read as a whole each time.
    n_parts = 1 + SAMPLE_BYTES * rows.size * channels.size // WINDOW_BYTES if header.kind in READ_IN_PART else 1
    for part in np.array_split(rows, n_parts):
        _, flags, nsamples = read_samples(header, part, channels, np.array([where]))
        check_nsamples(nsamples, flags, header.path)
        good = ~flags[..., 0] & (nsamples[..., 0] > 0)
        known = nsamples[good, 0]
        yield part, good, [float(known.min()), float(known.max())] if known.size else []
