"""Visibilities of a truth, by matvis."""

from __future__ import annotations

from dataclasses import replace

import matvis
import numpy as np
from astropy.time import Time

from tests.validation.undeclared.beams import Shape, pyuvdata_beam
from tests.validation.undeclared.setting import LOCATION, Catalogue
from tests.validation.undeclared.truth import ComplexArray, Truth

INSTANTS = 15
"""In an integration. A mean over T of so many, each in the middle of its part, is shorter than T by a 450th."""


def correlations(truth: Truth) -> ComplexArray:
    """Return what all pairs of antennas would measure without corruption and noise, (Nfreqs, Ntimes, Nants, Nants).

    V_jk = 1/2 sum_s I_s a_j(s) a_k(s) exp(2 pi i nu (x_k - x_j).s/c), with a the fields.
    """
    if truth.integration:
        steps = (np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5
        instants = (replace(truth, integration=0.0, clock=truth.clock + step * truth.integration) for step in steps)
        return np.asarray(sum(map(correlations, instants)) / INSTANTS)
    setting = truth.setting
    times = setting.times + truth.clock / 86400
    n_freqs, n_times, _ = setting.shape
    if not truth.changes:
        return np.array([_observe(truth, truth.catalogue, truth.shapes, f, times) for f in range(n_freqs)])
    out = np.zeros((n_freqs, n_times, setting.n_ants, setting.n_ants), dtype=complex)
    for f in range(n_freqs):
        for t in range(n_times):
            catalogue = truth.catalogue
            for change in truth.sky_of:
                catalogue = change(f, t, catalogue)
            out[f, t] = _observe(truth, catalogue, truth.shapes_at(f, t), f, times[t : t + 1])[0]
    return out


def _observe(truth: Truth, catalogue: Catalogue, shapes: list[Shape], channel: int, times: np.ndarray) -> ComplexArray:
    """Return all correlations of one channel, (Ntimes, Nants, Nants)."""
    n = len(shapes)
    distinct: list[Shape] = []
    index = []
    for shape in shapes:
        found = next((i for i, known in enumerate(distinct) if known is shape), None)
        if found is None:
            found = len(distinct)
            distinct.append(shape)
        index.append(found)
    freq = truth.setting.freqs[channel]
    pairs = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
    vis = matvis.simulate_vis(
        ants=dict(enumerate(truth.antpos)),
        fluxes=catalogue.at(freq)[:, np.newaxis],
        ra=catalogue.ra,
        dec=catalogue.dec,
        freqs=np.array([freq]),
        times=Time(times, format="jd"),
        beams=[pyuvdata_beam(shape) for shape in distinct],
        beam_idx=np.array(index),
        telescope_loc=LOCATION,
        precision=2,
        antpairs=pairs,
        coord_method="CoordinateRotationAstropy",
    )
    return np.asarray(vis[0]).reshape(len(times), n, n)


def corrupted(truth: Truth, clean: ComplexArray | None = None) -> ComplexArray:
    """Return what is measured but for the noise, (Nfreqs, Ntimes, Nants, Nants)."""
    vis = correlations(truth) if clean is None else clean
    for corruption in truth.corruptions:
        vis = corruption(vis)
    return vis


def on_baselines(truth: Truth, vis: ComplexArray) -> ComplexArray:
    """Return the setting's baselines of all correlations, (Nfreqs, Ntimes, Nbls)."""
    pairs = truth.setting.antpairs
    return vis[:, :, pairs[:, 0], pairs[:, 1]]
