"""How well the draws of chains predict held-out rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from hydrabeam_mpi.sampling.storage.store import ChainStore

RMS, CHI2, LOG_DENSITY = "heldout_rms", "heldout_chi2", "heldout_log_density"
"""Names of what is known of every draw."""


@dataclass(frozen=True)
class HeldOut:
    """How well draws predict held-out rows.

    Attributes
    ----------
    rms, rms_std : float
        Of the residuals, Jy: mean and standard deviation of the draws'.
    chi2, chi2_std : float
        The same of chi^2 by the stated noise over the number of data.
    log_density : float
        Mean of ln p(held-out rows | draw).
    log_predictive : float
        ln of the mean of p(held-out rows | draw): the log predictive density, which with few draws is too low.
    """

    rms: float
    rms_std: float
    chi2: float
    chi2_std: float
    log_density: float
    log_predictive: float

    def __str__(self) -> str:
        """Return a line for a terminal."""
        return (
            f"held-out rows: rms {self.rms:.4g} +- {self.rms_std:.2g} Jy, chi^2 by the stated noise {self.chi2:.4g} +- "
            f"{self.chi2_std:.2g}; log predictive density {self.log_predictive:.6g} (mean over draws of the log "
            f"density {self.log_density:.6g})"
        )


def heldout_of(store: ChainStore) -> HeldOut | None:
    """Sum up the draws of a folder's chains after the warm-up; None where there are none, or no rows are held out."""
    chains, draws = store.comparable()
    if draws.stop == draws.start or LOG_DENSITY not in store.info_names(chains[0]):
        return None
    rms, chi2, told = (
        np.concatenate([store.info(name, chain, draws) for chain in chains]) for name in (RMS, CHI2, LOG_DENSITY)
    )
    means, stds = ([float(of(one)) for one in (rms, chi2, told)] for of in (np.mean, np.std))
    predictive = float(logsumexp(told) - np.log(len(told)))
    return HeldOut(means[0], stds[0], means[1], stds[1], means[2], predictive)
