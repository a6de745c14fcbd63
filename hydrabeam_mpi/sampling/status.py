"""How far chains are, how they mix, and how long they still take; also while they run."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.sampling.convergence import Diagnosis, diagnose
from hydrabeam_mpi.sampling.heldout import HeldOut, heldout_of
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.words import duration, text_table

LATEST = 100
"""Draws from which the pace is taken."""


@dataclass(frozen=True)
class Progress:
    """How far a chain is.

    Attributes
    ----------
    chain : int
    n_draws, total : int
        Draws that are whole and wanted, warm-up included.
    seconds : float
        Of a draw, the median of the last ones; NaN before the first.
    latest : float
        When the last one ended, s since 1970.
    """

    chain: int
    n_draws: int
    total: int
    seconds: float
    latest: float


@dataclass(frozen=True)
class Status:
    """How far the chains of a folder are.

    Attributes
    ----------
    chains : tuple of Progress
    warm_up : int
        Draws at the begin of each that do not count.
    seconds_left : float
        At the pace of the last draws; NaN before the first.
    diagnosis : Diagnosis
    cautions : tuple of str
        What is damaged, and which blocks have not converged.
    held_out : HeldOut, optional
        How well draws predict held-out rows, if any are.
    """

    chains: tuple[Progress, ...]
    warm_up: int
    seconds_left: float
    diagnosis: Diagnosis
    cautions: tuple[str, ...]
    held_out: HeldOut | None = None

    def __str__(self) -> str:
        """Return tables of it for a terminal."""
        now = time.time()
        rows = [("chain", "draws", "seconds a draw", "last draw")]
        for one in self.chains:
            last = f"{duration(now - one.latest)} ago" if one.n_draws else ""
            rows.append((str(one.chain), f"{one.n_draws} of {one.total}", number(one.seconds), last))
        parts = [text_table(rows)]
        if self.warm_up:
            parts.append(f"The first {self.warm_up} draws of each chain are its warm-up and do not count below.")
        left = sum(max(0, one.total - one.n_draws) for one in self.chains)
        if left:
            parts.append(f"time left: {duration(self.seconds_left)}" if np.isfinite(self.seconds_left) else "")
        else:
            parts.append("all draws are there")
        parts.append(mixing_table(self.diagnosis))
        parts.append(str(self.held_out or ""))
        parts.append("\n".join(f"warning: {line}" for line in self.cautions))
        return "\n\n".join(filter(None, parts))


def status_of(store: ChainStore) -> Status:
    """Look at the chains of a folder.

    Raises
    ------
    InputError
        If a file goes while it is read.
    """
    chains = tuple(_progress(store, chain) for chain in range(store.chains))
    diagnosis = diagnose(store)
    cautions = (*store.cautions(), *diagnosis.warnings())
    return Status(chains, store.warm_up, _seconds_left(store, chains), diagnosis, cautions, heldout_of(store))


def mixing_table(diagnosis: Diagnosis) -> str:
    """Return R-hat and ESS of each block as a table."""
    rows = [("block", "parameters", "R-hat", "ESS bulk", "ESS tail", "ESS a second", "worst parameter")]
    for one in diagnosis.blocks:
        r_hat = f"{one.r_hat:.4g}" if one.r_hat > 0 else "-"
        sizes = (number(one.ess_bulk), number(one.ess_tail), number(one.ess_per_second))
        rows.append((one.block, str(one.n_parameters), r_hat, *sizes, one.worst))
    return text_table(rows)


def _progress(store: ChainStore, chain: int) -> Progress:
    n = store.n_draws(chain)
    if not n:
        return Progress(chain, 0, store.total, float("nan"), float("nan"))
    last = slice(max(0, n - LATEST), n)
    seconds = float(np.median(store.info("seconds", chain, last)))
    return Progress(chain, n, store.total, seconds, float(store.info("time", chain, slice(n - 1, n))[0]))


def _seconds_left(store: ChainStore, chains: tuple[Progress, ...]) -> float:
    """Return how long the rest takes at the pace of all chains together in the last `LATEST` draws' time."""
    begun = [one for one in chains if one.n_draws]
    if not begun:
        return float("nan")
    seconds = float(np.median([one.seconds for one in begun]))
    last = [slice(max(0, one.n_draws - LATEST), one.n_draws) for one in begun]
    times = np.concatenate([store.info("time", one.chain, draws) for one, draws in zip(begun, last, strict=True)])
    window = min(LATEST * seconds, float(np.ptp(times)) + seconds)
    pace = np.count_nonzero(times > times.max() - window) / window if window > 0 else np.inf
    return float(sum(max(0, one.total - one.n_draws) for one in chains) / pace)


def number(value: float) -> str:
    """Write a number with three digits; a dash where it is not known."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}" if np.isfinite(value) else "-"
