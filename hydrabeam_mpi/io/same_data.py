"""Whether data are the same in whatever file: a checksum of each integration of each channel.

Neither format, order and orientation of baselines, precision beyond single, nor flags count; which baselines a file
holds does.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence

import numpy as np

from hydrabeam_mpi.data.observation import IntArray, Observation
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE, TIME_TOLERANCE, UVHeader
from hydrabeam_mpi.io.uvformat import FORMATS
from hydrabeam_mpi.io.uvrows import SAMPLE_BYTES, WINDOW_BYTES
from hydrabeam_mpi.io.uvsource import Data, Source, as_source
from hydrabeam_mpi.io.uvsurvey import pair_keys

DIGITS = 16
"""Hexadecimal digits kept: by chance two of a million integrations agree once in a hundred million cases."""


def integration_checksums(files: Sequence[Data], observation: Observation, part: int = 0, of: int = 1) -> list[str]:
    """Return a checksum of each integration and channel of an observation that files have data of. Serial.

    Of cross-correlations, at the observation's times, channels and polarisations, all that a file holds is read, some
    megabytes at a time. Integrations that are zero throughout have none. With ``of`` parts those of the times of one
    ``part`` alone are returned, so that several ranks can share the work.
    """
    lo, hi = part * observation.Ntimes // of, (part + 1) * observation.Ntimes // of
    return [told for source in map(as_source, files) for told in _checksums_of(source, observation, lo, hi)]


def _checksums_of(source: Source, observation: Observation, lo: int, hi: int) -> Iterator[str]:
    """Yield those of one file, from time ``lo`` of the observation to before ``hi``."""
    header, stored = source.metadata()
    channels = np.flatnonzero(match(header.freqs, observation.freqs, FREQ_TOLERANCE) >= 0)
    pols = np.array([pol for pol in map(header.pol_index, observation.pols) if pol >= 0], dtype=int)
    other_way = _other_way(header, pols)
    keys = pair_keys(np.sort(stored.antpairs, axis=1))
    time = match(stored.times, observation.times, TIME_TOLERANCE)
    time[stored.antpairs[:, 0] == stored.antpairs[:, 1]] = -1
    order = np.lexsort((keys, time))
    order = order[(time[order] >= lo) & (time[order] < hi)]
    if not (order.size and channels.size and pols.size):
        return
    in_part = header.kind not in FORMATS or FORMATS[header.kind].in_part
    at_once = max(WINDOW_BYTES // (SAMPLE_BYTES * channels.size * pols.size), 1) if in_part else order.size
    for rows in _parts(order, time, at_once):
        data = source.samples(header, rows, channels, pols, None)[0]
        turned = stored.antpairs[rows, 0] > stored.antpairs[rows, 1]
        data[turned] = data[turned][..., other_way].conj()
        # Adding zero takes the sign off zeros.
        values = (data + 0).astype(np.complex64)
        for one in _parts(np.arange(len(rows)), time[rows], 1):
            for block in values[one].swapaxes(0, 1):
                if block.any():
                    yield hashlib.sha256(keys[rows[one]].tobytes() + block.tobytes()).hexdigest()[:DIGITS]


def _other_way(header: UVHeader, pols: IntArray) -> IntArray:
    """Return where among some polarisations, (Npols,), each stands as a turned baseline has it: "en" for "ne"."""
    turned = [header.pol_index(header.pols[pol][::-1]) for pol in pols.tolist()]
    places = match(turned, pols, 0)
    # Where only one of the two was asked for, they are not known to be the same data.
    return np.where(places < 0, np.arange(len(pols)), places)


def _parts(rows: IntArray, time: IntArray, at_once: int) -> list[IntArray]:
    """Split rows in order of ``time`` into those of whole integrations, each begun by so many rows at most."""
    starts = np.flatnonzero(np.diff(time[rows], prepend=-1))
    number = starts // at_once
    return np.split(rows, starts[1:][np.diff(number) > 0])
