"""A result as other runs use it: the joint posterior of beam and effects, without what is there to be looked at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, IntArray, Observation
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.checksums import checksum
from hydrabeam_mpi.io.kept_rounds import check_ended
from hydrabeam_mpi.io.manifest import MANIFEST, read_manifest
from hydrabeam_mpi.io.posterior_file import PosteriorFile, read_covariance, read_posterior
from hydrabeam_mpi.io.together import check_of_one
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE
from hydrabeam_mpi.model.bases import basis_from_description
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.turned import Turned

POSTERIOR = "posterior.h5"
USED = ("mean", "covariance", "prior_mean", "model_mean", "effects_covariance", "effects_beam_response")
TURNS = {pair[::way]: way * np.pi / 2 for pair in (("ee", "nn"), ("xx", "yy")) for way in (1, -1)}
"""By what the beam of one polarisation is turned to be that of another one, radians from East through North."""
REMEDY = "make the result again with this version"
SURVEYED = 0.1
"""Metres by which positions of one antenna may differ at least: they are surveyed anew, and rounded by formats."""


@dataclass(frozen=True)
class Inferred:
    """A result.

    Attributes
    ----------
    content : PosteriorFile
    path : Path, optional
        The file that it was read from, and covariances are read from when they are asked for.
    numbers : tuple of int
        Which of the file's channels these are.
    turn : float
        Radians from East through North by which the beam is turned for another feed than that of the file.
    """

    content: PosteriorFile
    path: Path | None
    numbers: tuple[int, ...]
    turn: float = 0.0

    @classmethod
    def of(cls, content: PosteriorFile, path: Path | None = None) -> Inferred:
        """Leave out maps, draws and the like."""
        channels = [
            replace(one, summary={}, arrays={name: one.arrays[name] for name in USED if name in one.arrays})
            for one in content.channels
        ]
        return cls(replace(content, channels=channels), path, tuple(range(len(channels))))

    def of_channels(self, numbers: Sequence[int]) -> Inferred:
        """Keep some channels, in this order."""
        channels = [self.content.channels[number] for number in numbers]
        return replace(
            self,
            content=replace(self.content, channels=channels),
            numbers=tuple(self.numbers[number] for number in numbers),
        )

    def for_feed(self, pol: str) -> Inferred:
        """Return the result as of another polarisation, the feed of which is the same but for a quarter of a turn.

        The one that points North has the beam B(za, az - 90 deg), where B is that of the one that points East. Where
        the polarisations are no such pair this is the result as it is.
        """
        turn = TURNS.get((self.content.polarization, pol))
        return self if turn is None else replace(self, content=replace(self.content, polarization=pol), turn=turn)

    @cached_property
    def basis(self) -> LinearBasis:
        """That of the beam, without functions that effects have added to it."""
        own = basis_from_description((self.content.effects or {"basis": self.content.basis}).get("basis", {}))
        return Turned(own, self.turn) if self.turn else own

    @property
    def entries(self) -> Sequence[dict[str, Any]]:
        """The effects; see `hydrabeam_mpi.io.posterior_file`."""
        entries: Sequence[dict[str, Any]] = (self.content.effects or {}).get("entries", ())
        return entries

    @property
    def made_from(self) -> dict[str, str]:
        """Checksums of all files that it, and results that were its prior, have been made from."""
        about = self.content.provenance
        return {**about.get("sha256_before", {}), **about.get("sha256", {})}

    @property
    def integrations(self) -> frozenset[str]:
        """Checksums of all integrations that it, and results that were its prior, have been made from.

        Raises
        ------
        InputError
            If they are not told.
        """
        told = self.content.provenance.get("integrations")
        if not isinstance(told, list):
            raise InputError("does not tell which integrations it was made from", field="integrations", remedy=REMEDY)
        return frozenset(map(str, told))

    def covariance_of(self, channel: int) -> Array:
        """Return that of the beam's coefficients, effects marginalised, (n_modes, n_modes).

        Raises
        ------
        InputError
            If it cannot be read.
        """
        held = self.content.channels[channel].arrays.get("covariance")
        if held is not None:
            return held
        assert self.path is not None
        return read_covariance(self.path, self.numbers[channel])

    @property
    def model_means(self) -> tuple[Array, ...]:
        """The model beams' coefficients in the basis, (n_modes,) a channel.

        Raises
        ------
        InputError
            If there are fewer.
        """
        n = self.basis.n_modes
        arrays = [record.arrays for record in self.content.channels]
        means = tuple(one.get("model_mean", one["prior_mean"])[:n] for one in arrays)
        if any(len(mean) < n for mean in means):
            raise InputError(f"has not the {n} coefficients of its basis", field="prior_mean", remedy=REMEDY)
        return means

    @contextmanager
    def telling(self) -> Iterator[None]:
        """Name the file where something in it is wrong."""
        try:
            yield
        except InputError as error:
            error.locate(self.path or "result")
            raise

    def moved_antennas(self, observation: Observation, tol: float) -> dict[int, float]:
        """Return the antennas of an observation that stand elsewhere than those of their numbers here.

        Returns
        -------
        dict
            By their numbers how far, metres, where that is more than `SURVEYED` and than ``tol``; all may have moved
            together. None of a result of a version that does not tell where they stood.
        """
        known = self.content.observed.get("antenna_numbers", np.zeros(0, dtype=int))
        numbers, here, there = np.intersect1d(observation.antenna_numbers, known, return_indices=True)
        if not len(numbers):
            return {}
        moved = observation.antpos[here] - self.content.observed["antenna_positions"][there]
        away = np.linalg.norm(moved - np.median(moved, axis=0), axis=1)
        elsewhere = away > max(tol, SURVEYED)
        return dict(zip(numbers[elsewhere].tolist(), away[elsewhere].tolist(), strict=True))

    def channels_in(self, observation: Observation) -> IntArray:
        """Return the number of each of the data's channels among these, (Nfreqs,).

        Frequencies of one channel are the same but for the rounding in file headers, far below any channel's width;
        beams and gains of another one are not known.

        Raises
        ------
        InputError
            If one is not among them, or the polarisation is another.
        """
        content, freqs = self.content, np.array([record.freq for record in self.content.channels])
        if observation.pols[0] != content.polarization:
            raise InputError(
                f"is {observation.pols[0]!r}, the result is of {content.polarization!r}",
                field="[data] polarization",
                remedy=f'set polarization = "{content.polarization}"',
            )
        numbers = match(observation.freqs, freqs, FREQ_TOLERANCE)
        if np.any(numbers < 0):
            known = ", ".join(f"{freq / 1e6:.6f}" for freq in freqs)
            raise InputError(
                f"the result has no beam at {observation.freqs[numbers < 0][0] / 1e6:.6f} MHz",
                field="[data] freqs",
                remedy=f"select channels within {FREQ_TOLERANCE:g} Hz of the result's, {known} MHz",
            )
        return numbers


def read_inferred(folder: Path, field: str | None = None) -> Inferred:
    """Read a result folder, ``posterior.h5`` of which must be as it was written.

    Raises
    ------
    InputError
        If it is none, or the file has changed since.
    """
    check_ended(folder)
    check_of_one(folder, field)
    path, as_written = folder / POSTERIOR, _listed(folder, field)
    content = read_posterior(path)
    _check_unchanged(path, as_written)
    return Inferred.of(content, path)


def check_unchanged(folder: Path) -> None:
    """Make sure that ``posterior.h5`` of a result folder, which has been read, is as it was written.

    Raises
    ------
    InputError
        If the folder is no result, or the file has changed since.
    """
    _check_unchanged(folder / POSTERIOR, _listed(folder))


def _listed(folder: Path, field: str | None = None) -> str:
    """Return the checksum that a result's manifest lists of ``posterior.h5``."""
    listed = read_manifest(folder)
    if listed is None or POSTERIOR not in listed:
        told = f"is no result: no {MANIFEST} lists {POSTERIOR} in it"
        remedy = "name a folder written by 'hydrabeam infer' or 'hydrabeam loop'"
        raise InputError(told, file=folder, field=field, remedy=remedy)
    return listed[POSTERIOR]


def _check_unchanged(path: Path, as_written: str) -> None:
    if checksum(path) != as_written:
        raise InputError(f"has changed since {MANIFEST} was written", file=path, remedy="make the result again")
