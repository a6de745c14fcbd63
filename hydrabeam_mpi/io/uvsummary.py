"""What files of visibilities hold, including their flags: enough to set up a job."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.selection import Selection, match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.noise import odd_autocorrelations
from hydrabeam_mpi.io.uvdata import check_nsamples
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE, UVHeader, read_metadata, read_uvdata
from hydrabeam_mpi.io.uvformat import READ_IN_PART
from hydrabeam_mpi.io.uvmeta import linear_pols, read_observation
from hydrabeam_mpi.io.uvrows import SAMPLE_BYTES, WINDOW_BYTES, read_samples


@dataclass
class Power:
    """An antenna's autocorrelations: how many are known, how many are positive, and the sum of ln of these."""

    known: int = 0
    positive: int = 0
    logs: float = 0.0

    def add(self, autos: FloatArray) -> None:
        """Add some, (N,)."""
        positive = autos[autos > 0]
        self.known += autos.size
        self.positive += positive.size
        self.logs += float(np.log(positive).sum())

    @property
    def mean_log(self) -> float:
        """NaN where none is known, -inf where none is positive."""
        if not self.known:
            return np.nan
        return self.logs / self.positive if self.positive else -np.inf


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
    absurd_antennas : dict of int to str
        Those that are dead, or whose autocorrelations are absurd beside the others', and why.
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
    absurd_antennas: dict[int, str]
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
    living: set[int] = set()
    autos: set[int] = set()
    powers = {ant: Power() for ant in observation.antenna_numbers.tolist()}
    nsamples: set[float] = set()
    stated: dict[str, set[str]] = {"vis_units": set(), "pol_convention": set()}
    for path in files:
        header, rows = read_metadata(path)
        is_cross = rows.antpairs[:, 0] != rows.antpairs[:, 1]
        autos |= set(rows.antpairs[~is_cross, 0].tolist())
        channels = match(header.freqs, observation.freqs, FREQ_TOLERANCE)
        for part, data, good, samples in _parts(header, np.arange(len(rows.antpairs)), pol):
            cross = is_cross[part]
            good_channels[channels] |= good[cross].any(axis=0)
            good_antennas |= set(rows.antpairs[part[cross & good.any(axis=1)]].ravel().tolist())
            living |= set(rows.antpairs[part[cross & (good & (data != 0)).any(axis=1)]].ravel().tolist())
            for row, values, known in zip(part[~cross].tolist(), data[~cross].real, good[~cross], strict=True):
                if rows.antpairs[row, 0] in powers:
                    powers[rows.antpairs[row, 0]].add(values[known])
            known_samples = samples[cross[:, np.newaxis] & good]
            nsamples |= {float(known_samples.min()), float(known_samples.max())} if known_samples.size else set()
        uv = read_uvdata(path, header.kind, **({"read_data": False} if header.kind in READ_IN_PART else {}))
        for name, values in stated.items():
            values |= {str(getattr(uv, name))} if getattr(uv, name) else set()
    if good_antennas and not living:
        raise InputError("all visibilities that are not flagged are zero", file=files[0], remedy="check what wrote it")
    return Summary(
        observation=observation,
        pol=pol,
        flagged_channels=~good_channels,
        flagged_antennas=tuple(sorted(set(observation.antenna_numbers.tolist()) - good_antennas)),
        nsamples=(min(nsamples), max(nsamples)) if nsamples else (),
        absurd_antennas=_absurd(powers, good_antennas, living),
        has_autos=bool(good_antennas) and good_antennas <= autos,
        units=tuple(sorted(stated["vis_units"])),
        pol_conventions=tuple(sorted(stated["pol_convention"])),
    )


def _first_pol(pols: Sequence[str], path: Path) -> str:
    """Choose a polarisation that the model can describe: the first of equal feeds, or else the first."""
    linear = linear_pols(pols, path)
    return next((pol for pol in linear if pol[0] == pol[1]), linear[0])


def _absurd(powers: dict[int, Power], good: set[int], living: set[int]) -> dict[int, str]:
    """Say which antennas with unflagged samples are dead or absurd, and why."""
    numbers = sorted(good)
    logs = np.array([powers[ant].mean_log for ant in numbers])
    why = {numbers[k]: reason for k, reason in odd_autocorrelations(logs, np.isneginf(logs)).items()}
    return dict(sorted((why | dict.fromkeys(good - living, "all its visibilities are zero")).items()))


def _parts(
    header: UVHeader, rows: IntArray, pol: str
) -> Iterator[tuple[IntArray, ComplexArray, BoolArray, FloatArray]]:
    """Yield rows, their samples, which of these are good, and their nsamples, each (Nrows, Nfreqs) but the rows."""
    where = header.pol_index(pol)
    if where < 0 or not rows.size:
        return
    channels = np.arange(len(header.freqs))
    # Other formats are read as a whole each time.
    n_parts = 1 + SAMPLE_BYTES * rows.size * channels.size // WINDOW_BYTES if header.kind in READ_IN_PART else 1
    for part in np.array_split(rows, n_parts):
        data, flags, nsamples = read_samples(header, part, channels, np.array([where]))
        check_nsamples(nsamples, flags, header.path)
        good = ~flags[..., 0] & (nsamples[..., 0] > 0)
        yield part, data[..., 0], good, nsamples[..., 0]
