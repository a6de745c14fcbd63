"""What the numbers of a result say, in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hydrabeam_mpi.inference.predictive_checks import LARGEST_PREDICTIVE
from hydrabeam_mpi.words import from_to, megahertz_of

FAR = 2.0
"""Times as far from the model as its prior expects, from which on errors of what the data leave open are half of what
they should be."""
MOST_CHANNELS = 4
"""More channels than these are not told one by one, but the one that is predicted worst."""


def say_result(summary: Mapping[str, Any]) -> list[str]:
    """Say of each channel in a line how near the data are predicted, as ``summary.json`` has it."""
    channels = summary["channels"]
    if len(channels) <= MOST_CHANNELS:
        return list(map(_say_channel, channels))
    worst = max(channels, key=lambda one: one.get("heldout_chi2_predictive", 0.0))
    return [f"of {len(channels)} channels the one that is predicted worst, {_say_channel(worst)}"]


def _say_channel(channel: Mapping[str, Any]) -> str:
    at = f"{channel['freq_hz'] / 1e6:.6g} MHz"
    if "heldout_chi2_predictive" not in channel:
        return f"{at}: nothing is held out; reduced chi^2 of the fitted data {channel['train_chi2']:.3g}"
    beside = f"noise {channel['heldout_rms_jy_noise']:.3g}, model beam {channel['heldout_rms_jy_unperturbed']:.3g} Jy"
    chi2 = f"{channel['heldout_chi2_predictive']:.3g} under the posterior predictive (1 where it is calibrated)"
    return f"{at}: held-out rms {channel['heldout_rms_jy']:.3g} Jy ({beside}), reduced chi^2 {chi2}"


def warnings_of(channels: list[dict[str, Any]], by_evidence: bool = False) -> list[str]:
    """Say in plain words what a user should not overlook in the channels' summaries.

    With ``by_evidence`` the data were asked for the widths of the prior, which are what these wanted.
    """
    said = _warnings_of_heldout([channel for channel in channels if "heldout_chi2_predictive" in channel], by_evidence)
    negative = max(channel.get("negative_beyond_errors", 0.0) for channel in channels)
    if negative > 0.01:
        where = f"on up to {negative:.1%} of the sky by more than three standard deviations"
        said.append(f"The inferred power beam is negative {where}, which no power beam is.")
    imaginary = max(channel.get("imag_max", 0.0) for channel in channels)
    if imaginary > 1e-3:
        said.append(f"The inferred beam has imaginary parts up to {imaginary:.1e}, which no co-polarised beam has.")
    far = max(channels, key=lambda channel: channel.get("prior_departure", 1.0))
    if far.get("prior_departure", 1.0) > FAR:
        departure, gain = far["prior_departure"], far["prior_departure_log_evidence"]
        remedy = "`fraction` in [prior] as many times as large" + ("" if by_evidence else ", or widths = 'evidence'")
        loop = "" if by_evidence else ", for which 'hydrabeam loop' looks"
        said.append(
            f"The inferred beam is up to {departure:.2g} times as far from the model as its prior expects. "
            f"Widths as much larger have more evidence, by about {gain:.3g} in ln ({remedy}); or the beam takes up an "
            f"effect that the model lacks{loop}."
        )
    return said


def _warnings_of_heldout(channels: list[dict[str, Any]], by_evidence: bool) -> list[str]:
    """Say what the held-out data say against the inferred beam.

    Whether it predicts them is judged under the posterior predictive: residuals that the posterior itself expects,
    because the data leave the beam uncertain, say nothing against it however large they are beside the noise.
    """
    said = []
    chi2 = max((channel["heldout_chi2_predictive"] for channel in channels), default=0.0)
    if chi2 > LARGEST_PREDICTIVE:
        said.append(
            f"Held-out reduced chi^2 is up to {chi2:.3g} under the posterior predictive (noise and beam): the beam "
            "alone does not explain the data. Where sky, gains or another effect are wrong, the inferred beam takes "
            "up errors that are not its own. Its standard deviations know nothing of that, and are too small by a "
            f"factor of up to {np.sqrt(chi2):.2g} at least."
        )
    # Not known beside effects.
    known = [channel for channel in channels if "heldout_rms_jy_beyond_basis" in channel]
    small = [channel for channel in known if channel["heldout_rms_jy_beyond_basis"] > channel["heldout_rms_jy_noise"]]
    if small:
        freqs = megahertz_of(channel["freq_hz"] for channel in small)
        worst = max(small, key=lambda channel: channel["heldout_rms_jy_beyond_basis"])
        said.append(
            f"At {freqs} MHz the basis is too small for the model beam itself: of what that predicts it leaves "
            f"up to {worst['heldout_rms_jy_beyond_basis']:.3g} Jy rms, where the noise is "
            f"{worst['heldout_rms_jy_noise']:.3g} Jy. More functions of higher orders follow it, and [basis] rest = "
            "true makes what those of a Fourier-Bessel basis leave one more function."
        )
    lost = [c for c in channels if c["heldout_chi2_noise_only"] > c["heldout_chi2_unperturbed_scaled"]]
    lost = [channel for channel in lost if channel not in small]
    if lost:
        freqs = megahertz_of(channel["freq_hz"] for channel in lost)
        if not by_evidence:
            why = "its prior leaves more open than these data tell. "
            why += "With [prior] widths = 'evidence' they choose how much."
        elif chi2 > LARGEST_PREDICTIVE:
            why = "it takes up errors that are not its own."
        else:
            why = "these data tell next to nothing of how the beam departs from its model."
        said.append(
            f"At {freqs} MHz the model beam with one free amplitude predicts the held-out data better than the "
            f"inferred beam does: {why}"
        )
    amplitudes = [channel["heldout_amplitude_unperturbed"] for channel in channels]
    if any(abs(amplitude - 1) > 0.05 for amplitude in amplitudes):
        span = from_to(f"{min(amplitudes):.3g}", f"{max(amplitudes):.3g}")
        said.append(
            f"The model beam fits the held-out data best when it is {span} times as large: "
            "a wider beam or a narrower one does that, or data on another flux scale than the sky ([data] flux_scale), "
            "which cannot be told from the beam's amplitude. Then the peak of the inferred beam is not at one."
        )
        if any(abs(amplitude / factor - 1) < 0.05 for amplitude in amplitudes for factor in (0.5, 2.0)):
            said.append(
                "A factor of about two between data and model beam is what [data] pol_convention makes; 'hydrabeam "
                "loop' tests it."
            )
    return said
