"""The visibilities that a rank owns, out of many files.

Only what is asked for is read from uvh5 and uvfits files, and a sample that no file holds is flagged.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE, TIME_TOLERANCE
from hydrabeam_mpi.io.uvmeta import read_observation
from hydrabeam_mpi.io.uvrows import WINDOW_BYTES
from hydrabeam_mpi.io.uvsource import Data, as_source
from hydrabeam_mpi.io.uvsurvey import pair_keys

__all__ = ["Block", "feeds_of", "read_autos", "read_block", "read_observation", "read_visibilities"]


class Block(NamedTuple):
    """Visibilities with what is known of each; all arrays are (Nfreqs, Ntimes, Nbls, Npols).

    Attributes
    ----------
    data : ndarray of complex
        Zero where flagged.
    flags : ndarray of bool
        Also true where ``nsamples`` is not positive, where no file holds the sample and where it is excluded.
    nsamples : ndarray of float
    stored : ndarray of bool
        Whether a file holds the sample.
    """

    data: ComplexArray
    flags: BoolArray
    nsamples: FloatArray
    stored: BoolArray

    @classmethod
    def of_power(cls, power: FloatArray) -> Block:
        """Return autocorrelations, Jy, as of one sample each; flagged where not finite."""
        known = np.isfinite(power)
        return cls(np.where(known, power, 0.0).astype(np.complex128), ~known, known.astype(float), known)

    @property
    def power(self) -> FloatArray:
        """Of autocorrelations, Jy: zero where flagged, NaN where no file holds it."""
        return np.where(self.stored, self.data.real, np.nan)


def read_visibilities(
    files: Sequence[Data], observation: Observation, tile: Tile
) -> tuple[ComplexArray, BoolArray, FloatArray]:
    """Read the visibilities of a tile, and only those.

    Returns
    -------
    data, flags, nsamples : ndarray, (Nfreqs, len(tile.times), len(tile.bls), Npols)
        Jy; zero and flagged where no file holds the sample or its nsamples is not positive.

    Raises
    ------
    InputError
        If an unflagged visibility or nsamples is not finite, or two files hold the same sample.
    """
    block = read_block(files, observation, tile.times, observation.antpairs[tile.bls], observation.pols)
    return block.data, block.flags, block.nsamples


def feeds_of(pols: Sequence[str]) -> tuple[str, ...]:
    """Return the feeds that make up polarisations, in order of appearance: ("e", "n") for ("ee", "en")."""
    return tuple(dict.fromkeys("".join(pols)))


def read_autos(files: Sequence[Data], observation: Observation, times: IntArray) -> Block:
    """Read autocorrelations.

    Parameters
    ----------
    times : ndarray of int
        Indices into ``observation.times``.

    Returns
    -------
    Block
        (Nfreqs, len(times), Nants, Nfeeds), for the feeds of ``feeds_of(observation.pols)``.
    """
    pols = tuple(2 * feed for feed in feeds_of(observation.pols))
    antpairs = np.repeat(observation.antenna_numbers[:, None], 2, axis=1)
    return read_block(files, observation, times, antpairs, pols)


def read_block(
    files: Sequence[Data], observation: Observation, times: IntArray, antpairs: IntArray, pols: Sequence[str]
) -> Block:
    """Read the samples at some times and baselines, at all of the observation's channels.

    Parameters
    ----------
    times : ndarray of int
        Indices into ``observation.times``.
    antpairs : ndarray of int, (Nbls, 2)
        As stored; (a, a) is an autocorrelation.
    pols : sequence of str
    """
    block = _empty((observation.Nfreqs, len(times) * len(antpairs), len(pols)))
    for source in map(as_source, files if block.data.size else ()):
        if not source.may_hold(observation.times[times], observation.freqs):
            continue
        header, stored = source.metadata()
        time = match(stored.times, observation.times[times], TIME_TOLERANCE)
        baseline = match(pair_keys(stored.antpairs), pair_keys(antpairs), 0)
        rows = np.flatnonzero((time >= 0) & (baseline >= 0))
        channels = match(observation.freqs, header.freqs, FREQ_TOLERANCE)
        stored_pols = np.array([header.pol_index(pol) for pol in pols])
        here = np.ix_(channels >= 0, time[rows] * len(antpairs) + baseline[rows], stored_pols >= 0)
        if not all(index.size for index in here):
            continue
        if len(np.unique(here[1])) < len(rows) or block.stored[here].any():
            raise InputError(
                "holds a sample twice, or one that an earlier file holds", file=header.path, remedy="remove the copy"
            )
        data, flags, nsamples = source.samples(
            header,
            rows,
            channels[channels >= 0],
            stored_pols[stored_pols >= 0],
            observation.pol_convention,
        )
        n_parts = 1 + data.nbytes // WINDOW_BYTES
        for some in np.array_split(np.arange(len(rows)), n_parts):
            checked = _checked(data[some], flags[some], nsamples[some], header.path)
            for stack, values in zip(block, checked, strict=True):
                stack[here[0], here[1][:, some], here[2]] = values.swapaxes(0, 1)
    shape = (observation.Nfreqs, len(times), len(antpairs), len(pols))
    whole = Block(
        block.data.reshape(shape),
        block.flags.reshape(shape),
        block.nsamples.reshape(shape),
        block.stored.reshape(shape),
    )
    if observation.exclude_times or observation.exclude_baselines:
        excluded = observation.excluded(times, antpairs)
        whole.data[:, excluded], whole.flags[:, excluded] = 0.0, True
    return whole


def _empty(shape: tuple[int, int, int]) -> Block:
    """Return samples of which nothing is known."""
    return Block(np.zeros(shape, np.complex128), np.ones(shape, bool), np.zeros(shape), np.zeros(shape, bool))


def _checked(data: ComplexArray, flags: BoolArray, nsamples: FloatArray, path: Path) -> Block:
    """Flag samples without weight, blank what is flagged, and refuse what else is not finite or beyond reason."""
    check_nsamples(nsamples, flags, path)
    flags = flags | ~(nsamples > 0)
    if not np.isfinite(data[~flags]).all():
        raise InputError("unflagged NaN or infinite values", file=path, field="data_array", remedy="flag them")
    largest = np.max(size(data), where=~flags, initial=0.0)
    if largest > LARGEST:
        message = f"a visibility of {largest:.1e} Jy, which no source and no transmitter has"
        raise InputError(message, file=path, field="data_array", remedy="flag it, or correct the file")
    known = np.where(np.isfinite(nsamples), nsamples, 0.0)
    return Block(np.where(flags, 0.0, data), flags, known, np.ones(data.shape, bool))


def check_nsamples(nsamples: FloatArray, flags: BoolArray, path: Path) -> None:
    """Refuse numbers of samples that cannot be where there is no flag; those below zero are flags.

    Both are of any, but the same, shape.
    """
    if not np.isfinite(nsamples[~flags]).all():
        raise InputError("unflagged values that are not finite", file=path, field="nsample_array", remedy="flag them")
    if np.max(nsamples, where=~flags, initial=0.0) > LARGEST:
        raise InputError(f"more than {LARGEST:g}", file=path, field="nsample_array", remedy="correct the file")


def size(values: ComplexArray) -> FloatArray:
    """Return the larger of |real| and |imaginary| part, which unlike |values| cannot overflow; in the same shape."""
    return np.maximum(np.abs(values.real), np.abs(values.imag))
