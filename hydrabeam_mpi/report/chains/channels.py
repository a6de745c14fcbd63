"""What the chains say of the beam in each channel, as a table."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from hydrabeam_mpi.config.sample import NOISE
from hydrabeam_mpi.report.chains.pooled import beam_of, pool
from hydrabeam_mpi.report.chains.uncertainty import marginal_std, spread_of
from hydrabeam_mpi.report.page.parts import set_table
from hydrabeam_mpi.report.page.words import megahertz
from hydrabeam_mpi.sampling.convergence import Diagnosis
from hydrabeam_mpi.sampling.status import number
from hydrabeam_mpi.sampling.storage.store import ChainStore

COLUMNS = (
    "channel",
    "R-hat of the beam",
    "std of the beam, median",
    "over that with all else known, median",
    "largest",
    "noise variance over the stated one",
)


def channel_rows(store: ChainStore, diagnosis: Diagnosis) -> Markup:
    """Set key numbers of each channel, where there are several and draws of them.

    Parameters
    ----------
    store : ChainStore
    diagnosis : Diagnosis
        Of it.
    """
    beam = beam_of(store)
    if beam is None or beam.shape[0] < 2 or not diagnosis.chains:
        return Markup()
    r_hat = next(one.r_hat for one in diagnosis.variables if one.variable.name == beam.name)
    by_channel = r_hat.reshape(-1, beam.shape[0], beam.shape[1]).transpose(1, 0, 2)
    rows = []
    for channel, of_channel in enumerate(by_channel):
        pooled = pool(store, channel)
        if pooled is None:
            return Markup()
        spread = spread_of(pooled)
        ratio = np.full(1, np.nan) if spread is None else spread.ratio[np.isfinite(spread.ratio)]
        told = (np.median(marginal_std(pooled)), np.median(ratio), ratio.max())
        noise = [column for name, column in zip(pooled.labels, pooled.others.T, strict=True) if name.startswith(NOISE)]
        scale = f"{number(np.mean(noise))} +- {number(np.std(noise, axis=1).mean())}" if noise else "-"
        known = of_channel[np.isfinite(of_channel)]
        worst = f"{known.max():.4g}" if known.size else "-"
        name = str(channel) if pooled.freq is None else megahertz(pooled.freq)
        rows.append((name, worst, *map(number, told), scale))
    return set_table(COLUMNS, rows, range(1, len(COLUMNS)), "keys")
