"""What a user should not overlook of beams that hang together over frequency."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MENTION = 1.0
"""Nats that are worth a mention: odds of e to one (Kass and Raftery 1995)."""


def warnings_over_frequency(told: Mapping[str, Any]) -> list[str]:
    """Say it in plain words, of what `hydrabeam_mpi.fit.coupled` tells of all channels together."""
    said = []
    if told["covariances"] != "exact":
        said.append(
            "Beams that hang together over frequency were solved for by conjugate gradients: mean and draws are exact, "
            "covariances are estimates, of the preconditioner with variances from draws."
        )
    together, alone = told.get("log_evidence"), told["log_evidence_independent"]
    if together is not None and together < alone - MENTION:
        said.append(
            f"The data are likelier with independent channels (ln evidence {alone:.1f}) than with beams that hang "
            f"together over frequency as [prior.frequency] says ({together:.1f})."
        )
    lengths = told.get("lengths", ())
    if lengths and told["length"] in (lengths[0], lengths[-1]):
        said.append(
            f"The likeliest length over frequency, {told['length'] / 1e6:.4g} MHz, is the first or the last of those "
            "that were tried: further ones ([prior.frequency] length) may be likelier."
        )
    return said
