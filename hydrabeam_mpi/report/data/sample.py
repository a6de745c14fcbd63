"""The sample of held-out visibilities that a result keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.report.page.result import Channel, Result

BEFORE, AFTER = "model beam", "all that was inferred"
"""What the predictions are called in legends."""


@dataclass(frozen=True)
class Sample:
    """A sample of the held-out visibilities of a channel, baselines in the order of their lengths.

    Attributes
    ----------
    freq : float
        Hz.
    jd, hours : ndarray, (Nt,)
        Julian dates, and local sidereal times in hours, which go on beyond 24 where the observation does.
    antennas : ndarray of int, (Nbls, 2)
    vectors : ndarray, (Nbls, 3)
        East, North, Up in metres.
    data, before, after : ndarray of complex, (Nt, Nbls)
        Jy: measured, by the model beam, and by all that was inferred.
    weights : ndarray, (Nt, Nbls)
        One over the variance of the noise, Jy^-2; zero where there are no data.
    """

    freq: float
    jd: FloatArray
    hours: FloatArray
    antennas: IntArray
    vectors: FloatArray
    data: ComplexArray
    before: ComplexArray
    after: ComplexArray
    weights: FloatArray

    @property
    def used(self) -> BoolArray:
        """Where there are data, (Nt, Nbls)."""
        return self.weights > 0

    @property
    def residuals(self) -> dict[str, ComplexArray]:
        """What each prediction leaves, Jy; NaN where there are no data."""
        predictions = {BEFORE: self.before, AFTER: self.after}
        return {name: np.where(self.used, self.data - one, np.nan) for name, one in predictions.items()}

    @property
    def noise(self) -> FloatArray:
        """Standard deviation of the noise, E|n|^2 = noise^2, Jy; NaN where there are no data."""
        return np.divide(1.0, np.sqrt(self.weights), out=np.full(self.weights.shape, np.nan), where=self.used)

    def name(self, baseline: int) -> str:
        """Name a baseline by its antennas, length and direction."""
        one, two = self.antennas[baseline]
        east, north, _ = self.vectors[baseline]
        return f"{one}–{two}, {east:.0f} m E, {north:.0f} m N".replace("-", "−")


def sample_of(result: Result, channel: Channel) -> Sample | None:
    """Return a channel's sample; None where nothing was held out, or by a version that kept none."""
    told, arrays = result.observed, channel.arrays
    if "heldout_data" not in arrays or "heldout_jd" not in told:
        return None
    order = np.argsort(told["antenna_numbers"])
    places = order[np.searchsorted(told["antenna_numbers"], told["heldout_antennas"], sorter=order)]
    positions = told["antenna_positions"][places]
    vectors = positions[:, 1] - positions[:, 0]
    by_length = np.argsort(np.linalg.norm(vectors, axis=1).round(3), kind="stable")
    visibilities = (arrays[f"heldout_{name}"][:, by_length] for name in ("data", "before", "after", "weights"))
    hours = continued(np.rad2deg(told["heldout_lst"]) / 15)
    return Sample(
        channel.freq, told["heldout_jd"], hours, told["heldout_antennas"][by_length], vectors[by_length], *visibilities
    )


def continued(hours: FloatArray) -> FloatArray:
    """Return hours of a day, (N,), such that they begin after their largest gap and go on beyond 24."""
    ascending = np.sort(hours % 24)
    gaps = np.diff(ascending, append=ascending[0] + 24)
    first = ascending[(int(gaps.argmax()) + 1) % len(ascending)]
    return first + (hours - first + 1e-9) % 24
