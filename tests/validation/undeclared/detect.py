"""Whether data can show an effect at all, by what its maker knows of it."""

from __future__ import annotations

import numpy as np
from astropy.constants import c as speed_of_light

from tests.validation.undeclared.answer import Where
from tests.validation.undeclared.setting import Setting, altaz
from tests.validation.undeclared.truth import ComplexArray

LEAST_CHI2 = 50.0


def shows(chi2: float, n_params: int) -> bool:
    """Tell whether a chi^2 over all data is enough to notice an effect of so many parameters.

    Half of the data are fitted. What is gained there must pay for each parameter, by the logarithm of how well it is
    told, and for the choice of antennas, baselines or places.
    """
    return chi2 > LEAST_CHI2 + 2 * n_params * float(np.log1p(chi2 / (2 * n_params)))


def numbers_of_unknown(setting: Setting, where: Where) -> int:
    """Return as how many numbers something counts of which no list says what it looks like: each datum that it is in.

    With these `shows` asks for the likelihood ratio of a larger variance there: for x = chi2 / 2n of each of n data it
    is 2n (x - ln(1 + x)).
    """
    n_freqs, n_times, n_bls = setting.shape
    if where.antpairs is not None:
        n_bls = len(where.antpairs)
    elif where.antennas is not None:
        n_bls = int(np.isin(setting.numbers[setting.antpairs], where.antennas).any(axis=1).sum())
    n_times = n_times if where.times is None else len(where.times)
    return n_bls * n_times * (n_freqs if where.freqs is None else len(where.freqs))


def beam_design(setting: Setting, channel: int) -> ComplexArray:
    """Return the visibilities of every beam mode on every baseline, (Ntimes x Nbls, n)."""
    freq = float(setting.freqs[channel])
    flux = setting.catalogue.at(freq)
    rows = []
    for time in setting.times.tolist():
        za, az = altaz(setting.catalogue.ra, setting.catalogue.dec, time)
        up = za <= np.pi / 2
        za, az = za[up], az[up]
        directions = np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])
        fringes = np.exp(2j * np.pi * freq / speed_of_light.value * (setting.bl_vectors @ directions))
        rows.append((0.5 * flux[up] * fringes) @ setting.basis.modes(za, az).T)
    return np.concatenate(rows)


def chi2_beyond_beam(setting: Setting, change: ComplexArray, sigma: float) -> tuple[float, float]:
    """Return chi^2 of a change of the visibilities as it is, and of what no beam absorbs of it.

    Parameters
    ----------
    setting : Setting
    change : ndarray, (Nfreqs, Ntimes, Nbls)
        Jy.
    sigma : float
        Jy.
    """
    total = left = 0.0
    for channel, values in enumerate(change):
        matrix, vector = beam_design(setting, channel), values.reshape(-1)
        if setting.basis.form == "real":
            matrix, vector = (np.concatenate([part.real, part.imag]) for part in (matrix, vector))
        coeffs, *_ = np.linalg.lstsq(matrix, vector, rcond=1e-10)
        total += 2 * float(np.sum(np.abs(vector) ** 2)) / sigma**2
        left += 2 * float(np.sum(np.abs(vector - matrix @ coeffs) ** 2)) / sigma**2
    return total, left
