"""The visibilities of some rows of one file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pyuvdata import UVData

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.io.reading import reading
from hydrabeam_mpi.io.uvfile import UVHeader, read_uvdata
from hydrabeam_mpi.io.uvformat import FORMATS

# To pick one scattered row takes h5py as long as to read this many bytes in line.
SEEK_BYTES = 25_000
# Bytes read at once where unwanted rows are read with the wanted ones.
WINDOW_BYTES = 32_000_000
# A visibility in double precision, its flag and its nsamples.
SAMPLE_BYTES = 16 + 1 + 4

Samples = tuple[ComplexArray, BoolArray, FloatArray]


def read_samples(
    header: UVHeader, rows: IntArray, channels: IntArray, pols: IntArray, pol_convention: str | None = None
) -> Samples:
    """Read part of a file: visibilities, flags and nsamples.

    Phased visibilities are turned back to drift scan. Visibilities in the convention I = (V_xx + V_yy) / 2
    ("avg") are halved, so that they are V = 1/2 I B ("sum").

    Parameters
    ----------
    header : UVHeader
    rows, channels, pols : ndarray of int, (N,) each of its own length
        Indices of distinct rows, channels and polarisations in the file, in any order.
    pol_convention : {"sum", "avg"}, optional
        Of a file that does not state it; "sum" if that is not given either.

    Returns
    -------
    data, flags, nsamples : ndarray, (len(rows), len(channels), len(pols))
    """
    if not FORMATS[header.kind].in_part:
        return _samples(header, {}, np.ix_(rows, channels, pols), pol_convention)
    # pyuvdata returns what it selects in the order of the file.
    select: dict[str, Any] = {"polarizations": [header.feed_pols[pol] for pol in np.sort(pols)]}
    # Of several spectral windows in uvfits it reads all channels or fails.
    channels_read, picked_channels = np.arange(len(header.freqs)), channels
    if header.n_windows == 1 or FORMATS[header.kind].sample_by_sample:
        channels_read, picked_channels = np.sort(channels), np.argsort(np.argsort(channels))
        select["freq_chans"] = channels_read
    if FORMATS[header.kind].sample_by_sample:
        select["multidim_index"] = True
    picked = picked_channels, np.argsort(np.argsort(pols))
    order, shape = np.argsort(rows), (len(rows), len(channels), len(pols))
    whole: Samples = np.empty(shape, np.complex128), np.empty(shape, bool), np.empty(shape)
    done = 0
    for read, wanted in _windows(rows[order], SAMPLE_BYTES * len(channels_read) * len(pols)):
        part = _samples(header, {"blt_inds": read, **select}, np.ix_(wanted, *picked), pol_convention)
        for stack, values in zip(whole, part, strict=True):
            stack[order[done : done + len(wanted)]] = values
        done += len(wanted)
    return whole


def in_drift_scan(uv: UVData) -> bool:
    """Tell whether no visibility is phased."""
    return all(centre["cat_type"] == "unprojected" for centre in uv.phase_center_catalog.values())


def _windows(rows: IntArray, row_bytes: int) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the rows to read at once and which of them are wanted, for ascending ``rows``.

    Many scattered rows are read with those between them, far quicker than picking them from the file. What is read at
    once is no larger than a window, so that little memory is needed beside that of the result.
    """
    rows_at_once = max(WINDOW_BYTES // row_bytes, 1)
    if (rows[-1] - rows[0] + 1) * row_bytes > len(rows) * SEEK_BYTES:
        for part in np.array_split(rows, -(-len(rows) // rows_at_once)):
            yield part, np.arange(len(part))
        return
    window = rows // rows_at_once
    for part in np.split(rows, np.flatnonzero(np.diff(window)) + 1):
        yield np.arange(part[0], part[-1] + 1), part - part[0]


def _samples(
    header: UVHeader, select: dict[str, Any], wanted: tuple[IntArray, ...], pol_convention: str | None
) -> Samples:
    """Take samples out of what pyuvdata reads, as drift scan and in the convention V = 1/2 I B."""
    uv = read_uvdata(header.path, header.kind, **select)
    with reading(header.path, header.kind):
        uv.data_array = uv.data_array.astype(np.complex128, copy=False)
        if not in_drift_scan(uv):
            uv.unproject_phase()
        if (uv.pol_convention or pol_convention) == "avg":
            uv.data_array.view(float)[:] *= 0.5
        return uv.data_array[wanted], uv.flag_array[wanted], uv.nsample_array[wanted].astype(float)
