"""One file of visibilities among many: what is kept of its metadata while all files are looked at."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.data.selection import distinct
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE, TIME_TOLERANCE, UVHeader
from hydrabeam_mpi.io.uvsource import Data, Source, as_source


@dataclass(frozen=True)
class Survey:
    """The distinct baselines and times among the rows of a file.

    Attributes
    ----------
    source : Source
    header : UVHeader
    antpairs : ndarray of int, (Nbls, 2)
        Of cross-correlations.
    times, lsts, integration_time : ndarray, (Ntimes,)
        JD, ascending; radians; seconds.
    """

    source: Source
    header: UVHeader
    antpairs: IntArray
    times: FloatArray
    lsts: FloatArray
    integration_time: FloatArray


def pair_keys(antpairs: IntArray) -> IntArray:
    """Return one integer a baseline; their order is that of (ant1, ant2)."""
    return (antpairs[:, 0] << 32) + antpairs[:, 1]


def survey(files: Iterable[Data]) -> list[Survey]:
    """Look at the metadata of files one after the other.

    Raises
    ------
    InputError
        If one cannot be used.
    """
    surveys: list[Survey] = []
    for source in map(as_source, files):
        one = _survey(source)
        # Files of one array have the same baselines mostly, and of many files these would fill the memory.
        if surveys and np.array_equal(surveys[-1].antpairs, one.antpairs):
            one = replace(one, antpairs=surveys[-1].antpairs)
        surveys.append(one)
    return surveys


def _survey(source: Source) -> Survey:
    header, rows = source.metadata()
    _check_channels(header)
    cross = np.flatnonzero(rows.antpairs[:, 0] != rows.antpairs[:, 1])
    keys, baseline = np.unique(pair_keys(rows.antpairs[cross]), return_inverse=True)
    _check_averaging(header.path, rows.times[cross], rows.integration_time[cross], baseline)
    first = cross[distinct(rows.times[cross], TIME_TOLERANCE)]
    return Survey(
        source,
        header,
        np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1),
        rows.times[first],
        rows.lsts[first],
        rows.integration_time[first],
    )


def _check_channels(header: UVHeader) -> None:
    """Refuse a file with two channels at one frequency, of which the data would be those of one."""
    if len(distinct(header.freqs, FREQ_TOLERANCE)) < len(header.freqs):
        freqs = np.sort(header.freqs)
        twice = freqs[1:][np.diff(freqs) <= FREQ_TOLERANCE][0]
        raise InputError(
            f"two channels at {twice / 1e6:.6f} MHz",
            file=header.path,
            field="freq_array",
            remedy="keep one with UVData.select(freq_chans=[...]), or correct the frequencies",
        )


def _check_averaging(path: Path, times: FloatArray, integration_time: FloatArray, baseline: IntArray) -> None:
    """Refuse baseline-dependent averaging: one time axis must serve all baselines; (Nrows,) each.

    Where integrations change in the course of the observation, those that overlap are of one length still.
    """
    mean = np.bincount(baseline, integration_time) / np.bincount(baseline)
    order = np.argsort(times)
    lengths = integration_time[order]
    # From the centre of a mean to that of one of its parts it is half of the part at most, to what follows all of it.
    overlap = 86400 * np.diff(times[order]) <= 0.75 * np.minimum(lengths[1:], lengths[:-1])
    differ = np.abs(np.diff(lengths)) > 0.01 * lengths[1:]
    if mean.size and np.ptp(mean) > 0.01 * mean.max() and np.any(overlap & differ):
        raise InputError(
            f"integrations of {mean.min():g} to {mean.max():g} s, depending on the baseline",
            file=path,
            field="integration_time",
            remedy="undo the averaging with UVData.upsample_in_time()",
        )
