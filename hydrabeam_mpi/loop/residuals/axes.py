"""Chi^2 along the axes of the data: antennas, baselines, groups, lengths, directions, times, frequencies, spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.inference.significance import chi2_sigma
from hydrabeam_mpi.loop.residuals.cube import Layout
from hydrabeam_mpi.loop.residuals.spectra import Spectrum
from hydrabeam_mpi.loop.residuals.sums import ResidualSums

MAX_LENGTHS = 16
N_DIRECTIONS = 12
N_LSTS = 48
SPECTRAL_CONCENTRATION = 4.0
"""Fraction of a spectrum into which the power of the model's own uncertainty, smooth over times and channels, is
assumed to fall at worst.
"""


@dataclass(frozen=True)
class Freedom:
    """What the model's uncertainty does to sums of |z|^2.

    The z of one part of the data have a covariance 1 - diag(M) + M with M the whitened covariance of the predictions.
    Its eigenvalues are less than about one, as fewer rows are held out than fitted, so that tr(M^2) <= tr(M) and the
    variance of a sum of N squares is 2 (N + tr M) at most; in parts of the data likewise in proportion. Sums are
    therefore taken as chi^2 scaled by c = 1 + tr(M) / N with N / c degrees of freedom.

    Attributes
    ----------
    share : float
        tr(M) / N: at most the number of fitted parameters over twice the number of complex data.
    """

    share: float

    @classmethod
    def of(cls, n_shared: float, n: float) -> Freedom:
        """Take ``n_shared`` as tr(M) of ``n`` complex data."""
        return cls(min(n_shared / (2 * n), 1.0) if n else 0.0)

    @property
    def scale(self) -> float:
        """The factor c."""
        return 1 + self.share

    def heavier(self, sums: ResidualSums) -> Freedom:
        """Allow for the scatter of sums over values with the tails that their distribution is found to have."""
        excess = sums.n * float(sums.quartic[0]) / max(sums.chi2, 1e-300) ** 2 - 2
        return Freedom(self.scale * (1 + max(excess, 0.0) / 2) - 1)


@dataclass(frozen=True)
class Axis:
    """Sums along one axis; entries without data are left out.

    Attributes
    ----------
    name : str
    what : list
        What each entry is, as written into JSON.
    n : ndarray, (K,)
        Complex data of each.
    power : ndarray, (K,)
        Sum of |z|^2 of each.
    extra : list of dict
        More about each entry, (K,); may be empty.
    values : ndarray, (K,)
        A number of each entry for sentences.
    spectral : bool
        Whether entries are spectral powers.
    oversampling : float
        Number of entries over the number of independent ones.
    """

    name: str
    what: list[Any]
    n: FloatArray
    power: FloatArray
    extra: list[dict[str, Any]]
    values: FloatArray
    spectral: bool = False
    oversampling: float = 1.0

    def __len__(self) -> int:
        return len(self.what)

    @property
    def chi2(self) -> FloatArray:
        """Reduced chi^2, (Nentries,)."""
        return self.power / (2 * self.n)

    @property
    def level(self) -> float:
        """Reduced chi^2 of all."""
        return float(self.power.sum() / (2 * self.n.sum()))

    def sigma(self, freedom: Freedom, level: float = 1.0) -> FloatArray:
        """Return each entry's significance against a common reduced chi^2, (Nentries,).

        Spectra of model errors are not white: an expectation within the limits of `SPECTRAL_CONCENTRATION` is taken
        that fits best.
        """
        level = max(level, 1e-300)
        ratio = self.chi2 / level
        if self.spectral:
            high = 1 + SPECTRAL_CONCENTRATION * freedom.share
            ratio = ratio / np.clip(ratio, 1 - freedom.share, high)
        return chi2_sigma(2 * self.n * ratio / freedom.scale, 2 * self.n / freedom.scale)

    def unevenness(self, freedom: Freedom) -> float:
        """Return the significance of entries differing from one another, whatever their common level."""
        if len(self) < 2:
            return 0.0
        chi2 = float(np.sum(self.sigma(freedom, self.level) ** 2))
        return float(chi2_sigma(chi2 / self.oversampling, (len(self) - 1) / self.oversampling))


def all_axes(sums: ResidualSums, layout: Layout) -> dict[str, Axis]:
    """Return the axes by name, those with data."""
    observation, redundant = layout.observation, layout.redundant
    group, n_groups = redundant.group, redundant.Ngroups
    antennas = sum(_binned(sums.by_baseline, index, observation.Nants) for index in layout.observation.antenna_index.T)
    numbers = observation.antenna_numbers
    groups = _binned(sums.by_baseline, group, n_groups)
    east_norths = [{"vector_m": vector} for vector in np.round(redundant.vectors, 3).tolist()]
    lsts = observation.lst_hours[layout.times]
    jds = observation.times[layout.times]
    times = [{"jd": jd, "lst_h": lst} for jd, lst in zip(jds.tolist(), np.round(lsts, 5).tolist(), strict=True)]
    lst_centres = (np.arange(N_LSTS) + 0.5) * 24 / N_LSTS
    lst_bin = (lsts * N_LSTS / 24).astype(int) % N_LSTS
    axes = [
        _axis("antennas", numbers.tolist(), np.asarray(antennas), numbers),
        _axis("baselines", observation.antpairs.tolist(), sums.by_baseline),
        _axis("groups", list(range(n_groups)), groups, extra=east_norths),
        _lengths(sums, layout),
        _directions(groups, redundant.vectors),
        _axis("times", times, sums.by_time, lsts),
        _axis("lsts", lst_centres.tolist(), _binned(sums.by_time, lst_bin, N_LSTS), lst_centres),
        _axis("freqs", observation.freqs.tolist(), sums.by_channel, observation.freqs),
        _spectrum("fringe_rates", layout.fringe_rates, sums.by_fringe_rate, sums.oversampling[0]),
        _spectrum("delays", layout.delays, sums.by_delay, sums.oversampling[1]),
    ]
    return {axis.name: axis for axis in axes if len(axis)}


def length_bins(layout: Layout) -> tuple[IntArray, int]:
    """Bin baselines by length: one bin per length where there are few lengths, else bins of equally many baselines.

    Returns the bin of each, (Nbls,), and how many bins there are.
    """
    lengths = np.round(np.linalg.norm(layout.redundant.vectors[layout.redundant.group], axis=1), 1)
    distinct = np.unique(lengths)
    if len(distinct) > MAX_LENGTHS:
        distinct = np.unique(np.quantile(lengths, np.arange(MAX_LENGTHS) / MAX_LENGTHS))
    return np.searchsorted(distinct, lengths, side="right") - 1, len(distinct)


def _binned(rows: FloatArray, index: IntArray, n_bins: int) -> FloatArray:
    return np.stack([np.bincount(index, row, n_bins) for row in rows])


def _axis(
    name: str,
    what: list[Any],
    sums: FloatArray,
    values: Sequence[float] | Array | None = None,
    extra: list[dict[str, Any]] | None = None,
) -> Axis:
    kept = np.flatnonzero(sums[0] > 0)
    numbers = np.arange(len(what)) if values is None else np.asarray(values)
    chosen = [extra[k] for k in kept] if extra else []
    return Axis(name, [what[k] for k in kept], sums[0, kept], sums[1, kept], chosen, numbers[kept].astype(float))


def _lengths(sums: ResidualSums, layout: Layout) -> Axis:
    bins, n_bins = length_bins(layout)
    lengths = np.linalg.norm(layout.redundant.vectors[layout.redundant.group], axis=1)
    low, high = np.full(n_bins, np.inf), np.zeros(n_bins)
    np.minimum.at(low, bins, lengths)
    np.maximum.at(high, bins, lengths)
    means = np.bincount(bins, lengths, n_bins) / np.maximum(np.bincount(bins, minlength=n_bins), 1)
    ranges = [{"range_m": pair} for pair in np.round(np.stack([low, high], axis=1), 3).tolist()]
    return _axis("lengths", np.round(means, 3).tolist(), _binned(sums.by_baseline, bins, n_bins), means, ranges)


def _directions(groups: FloatArray, vectors: FloatArray) -> Axis:
    """Bin groups by the direction of their vectors, degrees from East through North, either sense."""
    width = 180 / N_DIRECTIONS
    degrees = np.rad2deg(np.arctan2(vectors[:, 1], vectors[:, 0]))
    bins = np.round(degrees / width).astype(int) % N_DIRECTIONS  # East-west and north-south lie in the middle of theirs
    centres = (np.arange(N_DIRECTIONS) * width + 90) % 180 - 90
    return _axis("directions", centres.tolist(), _binned(groups, bins, N_DIRECTIONS), centres)


def _spectrum(name: str, spectrum: Spectrum, sums: FloatArray, oversampling: FloatArray) -> Axis:
    order = np.argsort(spectrum.values)
    values = spectrum.values[order]
    axis = _axis(name, values.tolist(), sums[:, order], values)
    factor = oversampling[1] / oversampling[0] if oversampling[0] else 1.0
    return replace(axis, spectral=True, oversampling=max(float(factor), 1.0))
