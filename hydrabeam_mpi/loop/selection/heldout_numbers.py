"""How near predictions come to the held-out data, in Jy: of a fit, of the model beam, of zero and of the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.predictive_density import density_of_channels
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.loop.selection.heldout_score import falls_of_blocks, rank_falls_of_blocks
from hydrabeam_mpi.mpi import allreduce_sum, together

SUMS = (
    "n", "weight", "data", "residual", "noise", "uncertain", "model_residual", "overlap_real", "overlap_imag", "model",
    "noise_only", "uncertain_only", "predictive", "log_noise", "misfit", "log_spread",
)  # fmt: skip

IN_SUMMARY = {
    "heldout_n": "n",
    "heldout_rms_jy": "rms",
    "heldout_rms_jy_noise": "rms_noise",
    "heldout_rms_jy_data": "rms_zero",
    "heldout_rms_jy_unperturbed": "rms_model",
    "heldout_rms_jy_unperturbed_complex": "rms_model_scaled",
    "heldout_explained": "explained",
    "heldout_explained_unperturbed": "explained_model",
    "heldout_explained_unperturbed_complex": "explained_model_scaled",
    "heldout_chi2_noise_only": "noise_only_chi2",
    "heldout_chi2_predictive": "predictive_chi2",
    "heldout_log_density": "log_density",
}
"""What ``summary.json`` calls these numbers; see `HeldoutStatistics.summary`."""


@dataclass(frozen=True)
class HeldoutNumbers:
    """Sums over the held-out data d that count, of all ranks.

    With w the weights of the data as they were read, which no effect changes, so that numbers of different rounds
    compare; r = d - C (A b + E) the residual in Jy of those data, not divided by a gain C; and m the visibilities of
    the model beam, with nothing fitted. A plain rms is sqrt(sum w |x|^2 / sum w), the explained variance of a
    prediction 1 - sum w |r|^2 / sum w |d|^2.

    Attributes
    ----------
    channels : ndarray, (len(SUMS), Nfreqs)
        Of each channel: the number of d; sums of w, of w |d|^2, of w |r|^2, of w times the variance of the noise (by
        the model's weights) and of w times that by what is uncertain of the model; of w |d - m|^2, w m* d (two parts)
        and w |m|^2; of |r|^2 over the variance of the noise, and of the variance by what is uncertain of the model over
        that; |z|^2 / 2 under the posterior predictive, see `Whitened`; and of the logarithm of the density of all of
        them -ln(pi variance of the noise), the misfit and the spread, see `Density`.
    times, groups : ndarray, (2, N)
        For each time and each redundant group the sums of w |r|^2 and of w.
    """

    channels: FloatArray
    times: FloatArray
    groups: FloatArray

    def __add__(self, other: HeldoutNumbers) -> HeldoutNumbers:
        """Return the sums over these data and others."""
        return HeldoutNumbers(self.channels + other.channels, self.times + other.times, self.groups + other.groups)

    def of_channel(self, number: int) -> dict[str, float]:
        """Return the numbers of one of the job's channels."""
        return _numbers(self.channels[:, [number]])

    def summary(self, number: int) -> dict[str, float]:
        """Return the numbers of one of the job's channels by their names in ``summary.json``; empty without data."""
        numbers = self.of_channel(number)
        return {name: numbers[own] for name, own in IN_SUMMARY.items()} if numbers["n"] else {}

    @property
    def of_all(self) -> dict[str, float]:
        """The numbers of all channels together; the model beam's best scale is each channel's own."""
        return _numbers(self.channels)

    def rise_sigma(self, before: HeldoutNumbers) -> float:
        """Return by how many standard errors the residual power rose, paired over blocks of times or of groups.

        Of those that scatter more: what beam and sky lack at one time is the same in many groups, which are then no
        draws of their own.
        """
        pairs = (self.times, before.times), (self.groups, before.groups)
        return min(map(max, falls_of_blocks(pairs), rank_falls_of_blocks(pairs)), default=0.0)

    def excess_sigma(self, squares: float) -> float:
        """Return the significance of residual power beyond what the noise, and what is uncertain of the model, give.

        ``squares`` is tr(M^2) with M the covariance of the predictions over that of the noise: see `predicted_power`.
        """
        n, power, uncertain = (
            float(self.channels[SUMS.index(name)].sum()) for name in ("n", "noise_only", "uncertain_only")
        )
        return float((power - n - uncertain) / np.sqrt(n + 2 * uncertain + squares / 2)) if n else 0.0


def _numbers(channels: FloatArray) -> dict[str, float]:
    by_name = dict(zip(SUMS, channels, strict=True))
    total = {name: float(values.sum()) for name, values in by_name.items()}
    taken = np.divide(
        by_name["overlap_real"] ** 2 + by_name["overlap_imag"] ** 2,
        by_name["model"],
        out=np.zeros(channels.shape[1]),
        where=by_name["model"] > 0,
    )
    scaled = float(np.maximum(by_name["data"] - taken, 0.0).sum())

    def rms(power: float) -> float:
        return float(np.sqrt(power / total["weight"])) if total["weight"] else float("nan")

    def explained(power: float) -> float:
        return 1 - power / total["data"] if total["data"] else float("nan")

    n = total["n"]
    return {
        "n": n,
        "rms": rms(total["residual"]),
        "rms_noise": rms(total["noise"]),
        "rms_expected": rms(total["noise"] + total["uncertain"]),
        "rms_zero": rms(total["data"]),
        "rms_model": rms(total["model_residual"]),
        "rms_model_scaled": rms(scaled),
        "explained": explained(total["residual"]),
        "explained_model": explained(total["model_residual"]),
        "explained_model_scaled": explained(scaled),
        "noise_only_chi2": total["noise_only"] / n if n else float("nan"),
        "predictive_chi2": total["predictive"] / n if n else float("nan"),
        "log_density": total["log_noise"] - total["log_spread"] - total["misfit"],
    }


def heldout_numbers(context: FitContext, fitted: Fitted) -> HeldoutNumbers:
    """Sum over the held-out rows as a fit predicts them, each channel by its own beam as a result knows that.

    Collective: all ranks of the grid.
    """
    whitened, density = whiten(context, with_whole_beams(context, fitted)), density_of_channels(context, fitted)
    observation, rows, world = context.setup.observation, context.test.rows, context.grid.world
    channels = np.zeros((len(SUMS), observation.Nfreqs))
    times, groups = np.zeros((2, observation.Ntimes)), np.zeros((2, context.setup.redundant.Ngroups))
    with together(world):
        used = whitened.used
        weight = np.where(used, rows.inv_noise_var, 0.0)
        data, model = rows.data, context.test.model_beam[:, :, rows.member]
        overlap = weight * model.conj() * data
        noise = np.where(used, whitened.noise, 1.0)
        powers = (weight * whitened.power, weight)
        terms = (
            used, weight, weight * np.abs(data) ** 2, powers[0], weight * whitened.noise, weight * whitened.uncertain,
            weight * np.abs(data - model) ** 2, overlap.real, overlap.imag, weight * np.abs(model) ** 2,
            np.where(used, whitened.power / noise, 0.0), np.where(used, whitened.uncertain / noise, 0.0),
            np.where(used, 0.5 * np.abs(whitened.z) ** 2, 0.0), np.where(used, -np.log(np.pi * noise), 0.0),
        )  # fmt: skip
        for row, term in enumerate(terms):
            channels[row, context.channels] = term.sum(axis=(1, 2))
        for row, term in enumerate(powers):
            np.add.at(times[row], rows.tile.times, term.sum(axis=(0, 2)))
            np.add.at(groups[row], rows.groups[rows.member], term.sum(axis=(0, 1)))
    for sums in (channels, times, groups):
        allreduce_sum(world, sums)
    for name, values in (("misfit", density.misfit), ("log_spread", density.log_spread)):
        channels[SUMS.index(name)] = values
    return HeldoutNumbers(channels, times, groups)
