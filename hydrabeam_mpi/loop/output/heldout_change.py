"""How well held-out data are predicted before and after, as ``loop.json`` tells it."""

from __future__ import annotations

from typing import Any

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.loop.selection.acceptance import Checked

FITTED = ("rms", "explained", "noise_only_chi2", "predictive_chi2", "log_density")
"""What a fit changes; the rest is told once, of the data that count after it."""


def heldout_change(before: Checked, after: Checked, freqs: FloatArray) -> dict[str, Any]:
    """Return the numbers of all channels, and in ``heldout_channels`` those of each; see `HeldoutNumbers`.

    Those after it of each channel have the names that ``summary.json`` has for them as well.
    """
    told = _change(before.numbers.of_all, after.numbers.of_all)
    told |= {"predictive_chi2_before": before.score.chi2, "predictive_chi2_after": after.score.chi2}
    channels = [
        {
            "freq_hz": freq,
            **_change(before.numbers.of_channel(number), after.numbers.of_channel(number)),
            **after.numbers.summary(number),
        }
        for number, freq in enumerate(freqs.tolist())
    ]
    return {**told, "heldout_channels": channels}


def _change(before: dict[str, float], after: dict[str, float]) -> dict[str, float]:
    told = {f"{name}_{when}": at[name] for name in FITTED for when, at in (("before", before), ("after", after))}
    return told | {name: value for name, value in after.items() if name not in (*FITTED, "n")}
