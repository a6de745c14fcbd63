"""Whether an excess has no structure at all, so that only the stated noise level is wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P
from hydrabeam_mpi.loop.residuals.axes import Freedom, all_axes
from hydrabeam_mpi.loop.residuals.coherent import KINDS, Coherence
from hydrabeam_mpi.loop.residuals.cube import Layout
from hydrabeam_mpi.loop.residuals.statistics import coherent_look, most_significant, shape_looks, significance
from hydrabeam_mpi.loop.residuals.sums import ResidualSums

WORDS = {
    "unevenness": "it is uneven over {}",
    "correlations": "it is correlated {}",
    "kurtosis": "the distribution of its values is not Gaussian",
    "largest": "single visibilities stand out",
}
PLACES = {
    "within redundant groups": "within redundant groups",
    "fringe_rates": "fringe rates",
    "lsts": "sidereal times",
}


def is_white(
    sums: ResidualSums, layout: Layout, n_shared: float = 0.0, coherent: Sequence[Coherence] = ()
) -> tuple[bool, str]:
    """Tell whether residuals are white noise of any one scale.

    Divide them by the scales of `antenna_scales` before to ask whether they are white noise of one scale an antenna.

    Parameters
    ----------
    sums : ResidualSums
        Of all ranks.
    layout : Layout
    n_shared, coherent : optional
        As in `statistics.statistics`.

    Returns
    -------
    white : bool
        Whether no look at all, corrected for their number, is less probable than 1e-3.
    why : str
        What is least like white noise, in words.
    """
    freedom = Freedom.of(n_shared, sums.n)
    axes = all_axes(sums, layout)
    looks = shape_looks(sums, axes, freedom)
    looks += [most_significant(axis, freedom, axis.level) for axis in axes.values() if len(axis) > 1]
    looks += [coherent_look(one, layout, sums.chi2 / max(2 * sums.n, 1.0)) for one in coherent]
    if not looks:
        return True, "there is too little to tell"
    found = significance(looks)
    if found["p"] >= SIGNIFICANT_P:
        return True, "it has no structure beyond chance"
    what = str(found["what"])
    where = PLACES.get(what, f"between {what}" if what.startswith("neighbouring") else what)
    words = WORDS.get(found["axis"], f"its {PLACES.get(found['axis'], found['axis'])} differ")
    if found["axis"] in KINDS:
        words = f"there are {found['axis']}, {what}"
    return False, f"{words.format(where)} ({abs(found['corrected_sigma']):.1f} sigma)"


def antenna_scales(sums: ResidualSums, layout: Layout) -> FloatArray:
    """Return variances s_i, (Nants,), such that the mean |z_ij|^2 is nearest to 2 s_i s_j, in the logarithm.

    Antennas without data, and combinations that the baselines do not constrain, get the scale nearest to one.
    """
    has = (sums.by_baseline[0] > 0) & (sums.by_baseline[1] > 0)
    n, power = sums.by_baseline[:, has]
    one, two = layout.observation.antenna_index[has].T
    n_ants = layout.observation.Nants
    # The logarithm of chi^2 with 2n degrees of freedom over 2n has variance 1/n, and mean -1/(2n).
    logs = np.log(power / (2 * n)) + 0.5 / n
    normal = np.zeros((n_ants, n_ants))
    np.add.at(normal, (one, one), n)
    np.add.at(normal, (two, two), n)
    np.add.at(normal, (one, two), n)
    np.add.at(normal, (two, one), n)
    right = np.bincount(one, n * logs, n_ants) + np.bincount(two, n * logs, n_ants)
    return np.exp(np.linalg.pinv(normal, hermitian=True) @ right)
