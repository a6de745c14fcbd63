"""Where rows of visibilities come from: a file, of which only what is asked for is read, or a UVData in memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from pyuvdata import UVData

from hydrabeam_mpi.data.observation import Array, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import quiet, reading
from hydrabeam_mpi.io.uvcheck import check_metadata
from hydrabeam_mpi.io.uvfile import (
    UVHeader,
    UVRows,
    file_kind,
    header_of,
    may_hold,
    read_metadata,
    read_uvdata,
    rows_of,
)
from hydrabeam_mpi.io.uvrows import Samples, in_drift_scan, read_samples

KEPT_BYTES = 64_000_000
"""Metadata kept in memory at most, of all files together: those of some million rows, which several steps ask for."""


@runtime_checkable
class Source(Protocol):
    """Rows of visibilities, a row being a baseline at a time. As text it is what messages call it."""

    @property
    def file(self) -> Path | None:
        """The file that they are from."""
        ...

    def metadata(self) -> tuple[UVHeader, UVRows]:
        """Return what is said of all rows, and of each."""
        ...

    def may_hold(self, times: FloatArray, freqs: FloatArray) -> bool:
        """Tell quickly that there is nothing at some times (JD) or frequencies (Hz), as `uvfile.may_hold` does."""
        ...

    def samples(
        self, header: UVHeader, rows: IntArray, channels: IntArray, pols: IntArray, pol_convention: str | None
    ) -> Samples:
        """Return visibilities, flags and nsamples, (Nrows, Nchannels, Npols), as `uvrows.read_samples` does."""
        ...


@dataclass(frozen=True)
class UVFile:
    """A file of visibilities.

    Attributes
    ----------
    path : Path
    room : int
        Bytes of metadata that are kept once they have been read; more are read whenever they are asked for.
    """

    path: Path
    room: int = 0
    _kept: list[tuple[UVHeader, UVRows]] = dataclasses.field(default_factory=list, repr=False, compare=False)

    def __str__(self) -> str:
        return str(self.path)

    @property
    def file(self) -> Path:
        """The file."""
        return self.path

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave what is kept behind."""
        return UVFile, (self.path, self.room)

    def metadata(self) -> tuple[UVHeader, UVRows]:
        """Read the metadata, or return them as they were read first."""
        if self._kept:
            return self._kept[0]
        found = read_metadata(self.path)
        if sum(array.nbytes for array in vars(found[1]).values()) <= self.room:
            self._kept.append(found)
        return found

    def may_hold(self, times: FloatArray, freqs: FloatArray) -> bool:
        """Look at the times and frequencies of a uvh5 file, or leave it to what is kept; see `Source.may_hold`."""
        return bool(self._kept) or may_hold(self.path, times, freqs)

    def samples(
        self, header: UVHeader, rows: IntArray, channels: IntArray, pols: IntArray, pol_convention: str | None
    ) -> Samples:
        """Read part of the file; see `Source.samples`."""
        return read_samples(header, rows, channels, pols, pol_convention)


@dataclass(frozen=True, eq=False)
class UVInMemory:
    """Visibilities in memory.

    Attributes
    ----------
    header : UVHeader
        Its path is the name that messages have for the data.
    rows : UVRows
    data : ndarray, (Nblts, Nfreqs, Npols)
        As drift scan.
    flags : ndarray of bool, same shape
    nsamples : ndarray, same shape
    file : Path or None
        Where they were read.
    """

    header: UVHeader
    rows: UVRows
    data: Array
    flags: BoolArray
    nsamples: FloatArray
    file: Path | None = None

    def __str__(self) -> str:
        return str(self.header.path)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file whole.

        Raises
        ------
        InputError
            As `uvfile.read_metadata`.
        """
        kind = file_kind(path)
        uv = read_uvdata(path, kind)
        with reading(path, kind):
            check_metadata(uv, path)
            header, rows = header_of(uv, path, kind), rows_of(uv)
            uv.data_array = uv.data_array.astype(np.complex128)
            if not in_drift_scan(uv):
                uv.unproject_phase()
        return cls(header, rows, uv.data_array, uv.flag_array, uv.nsample_array, path)

    @classmethod
    def of(cls, uv: UVData, name: str) -> Self:
        """Take a UVData as it is; phased data are copied and turned back to drift scan.

        Raises
        ------
        InputError
            If its metadata cannot be so, or it holds nothing else.
        """
        path = Path(name)
        samples = ("data_array", "flag_array", "nsample_array")
        lacking = next((field for field in samples if getattr(uv, field) is None), None)
        if lacking:
            raise InputError("is not there", file=path, field=lacking, remedy="read the file with its data")
        check_metadata(uv, path)
        for field in samples:
            found, expected = np.shape(getattr(uv, field)), (uv.Nblts, uv.Nfreqs, uv.Npols)
            if found != expected:
                message = f"has the shape {found}, where the metadata say {expected}"
                raise InputError(message, file=path, field=field, remedy="UVData.check() tells more")
        header, rows = header_of(uv, path, "memory"), rows_of(uv)
        if not in_drift_scan(uv):
            with quiet():
                uv = uv.copy()
                uv.data_array = uv.data_array.astype(np.complex128)
                uv.unproject_phase()
        return cls(header, rows, uv.data_array, uv.flag_array, uv.nsample_array)

    def with_sigma(self, variance: Array, name: str) -> UVInMemory:
        """Return the standard deviations of the noise of each visibility in its place, as a file of noise has them.

        Parameters
        ----------
        variance : array_like
            Jy^2, E|n|^2 in the data's own convention; broadcast to (Nblts, Nfreqs, Npols).

        Raises
        ------
        InputError
            If it has another shape, or is not real.
        """
        shape, given = self.data.shape, np.asarray(variance)
        try:
            values = np.broadcast_to(given, shape)
        except ValueError:
            values = np.zeros(0)
        if given.dtype.kind not in "iuf" or values.shape != shape:
            told = f"is an array of {given.dtype} with the shape {given.shape}"
            remedy = f"give variances (Jy^2) in a shape that broadcasts to that of data_array, {shape}"
            raise InputError(told, file=name, remedy=remedy)
        known = (values > 0) & np.isfinite(values)
        sigma = np.where(known, np.sqrt(np.where(known, values, 0.0)), 0.0)
        header = replace(self.header, path=Path(name))
        return UVInMemory(header, self.rows, sigma, self.flags, np.ones(shape))

    def metadata(self) -> tuple[UVHeader, UVRows]:
        """Return the metadata."""
        return self.header, self.rows

    def may_hold(self, times: FloatArray, freqs: FloatArray) -> bool:
        """Return True: all metadata are at hand; see `Source.may_hold`."""
        return True

    def samples(
        self, header: UVHeader, rows: IntArray, channels: IntArray, pols: IntArray, pol_convention: str | None
    ) -> Samples:
        """Take part of the data, in the convention V = 1/2 I B; see `Source.samples`."""
        wanted = np.ix_(rows, channels, pols)
        data: ComplexArray = self.data[wanted].astype(np.complex128)
        if (self.header.pol_convention or pol_convention) == "avg":
            data.view(float)[:] *= 0.5
        return data, self.flags[wanted], self.nsamples[wanted].astype(float)


Data = Path | Source
"""Where rows come from, a file by its name."""


def as_source(data: Data) -> Source:
    """Return a file, or what is in memory already, by its common interface."""
    return data if isinstance(data, Source) else UVFile(Path(data))


def files_among(data: Iterable[Data]) -> list[Path]:
    """Return the files that they are, or are from."""
    files = (one.file if isinstance(one, Source) else Path(one) for one in data)
    return [file for file in files if file is not None]
